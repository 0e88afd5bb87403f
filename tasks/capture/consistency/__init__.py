"""Facts of a recording that contradict each other: poses, depth unit, intrinsics and image sizes, judged by its depth."""
