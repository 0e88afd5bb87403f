"""A virtual scanner: walks through a furnished scene, casts rays, fuses what they hit, writes a ScanNet-format folder."""

from tasks.scanner.config import ScannerConfig
from tasks.scanner.session import ScannedObject, ScanTruth, scan_scene

__all__ = ["ScanTruth", "ScannedObject", "ScannerConfig", "scan_scene"]
