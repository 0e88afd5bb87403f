"""Environment variables for programs of others: a list of names, and nothing besides."""

from __future__ import annotations

import os

KEPT_VARIABLES = (
    "PATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH",
    "HOME", "USER", "LOGNAME", "TMPDIR",
    "LANG", "LC_ALL", "LC_CTYPE", "TZ",
    "XDG_CACHE_HOME", "HF_HOME", "HF_HUB_OFFLINE", "TORCH_HOME",
    "CUDA_HOME", "CUDA_PATH", "CUDA_VISIBLE_DEVICES", "CUDA_DEVICE_ORDER",
    "NVIDIA_VISIBLE_DEVICES", "NVIDIA_DRIVER_CAPABILITIES",
    "HIP_VISIBLE_DEVICES", "ROCR_VISIBLE_DEVICES", "HSA_OVERRIDE_GFX_VERSION",
    "OMP_NUM_THREADS",
)  # fmt: skip
"""Variables that a program of others receives: where programs, libraries, homes and caches are,
which language, and which graphics card. Their values are paths, names and numbers, never secrets.
"""


def child_environment() -> dict[str, str]:
    """Variables of this process's environment that a program of others receives."""
    return {name: os.environ[name] for name in KEPT_VARIABLES if name in os.environ}
