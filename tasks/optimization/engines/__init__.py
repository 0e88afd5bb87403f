"""Physics engines that certify what was optimized."""
