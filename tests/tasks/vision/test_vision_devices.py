"""Where networks run, and what folders are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from schemas.errors import InputError
from tasks.vision.devices import NetworkSettings, device_of, opened


@pytest.mark.parametrize("device", ["gpu", "cuda:", "cuda:x", "cpu:0", "CUDA", ""])
def test_devices_that_are_none_are_refused(device: str) -> None:
    with pytest.raises(ValueError, match="device"):
        NetworkSettings(device=device)


@pytest.mark.whole
def test_a_card_that_is_not_there_is_told() -> None:
    torch = pytest.importorskip("torch")
    assert device_of("cpu", "x") == "cpu"
    there = torch.cuda.device_count() if torch.cuda.is_available() else 0
    assert device_of("auto", "x") == ("cuda:0" if there else "cpu")
    with pytest.raises(InputError, match=r"^x: device: is cuda:99, and torch sees "):
        device_of("cuda:99", "x")


@pytest.mark.whole
def test_folders_that_hold_no_such_network_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("transformers")
    with pytest.raises(InputError, match="weights: names no folder"):
        opened(NetworkSettings(), "SamModel", "x")
    with pytest.raises(InputError, match=r"holds no \*\.safetensors"):
        opened(NetworkSettings(weights=str(tmp_path)), "SamModel", "x")
    (tmp_path / "model.safetensors").write_bytes(b"x")
    with pytest.raises(InputError, match="holds no SamModel"):
        opened(NetworkSettings(weights=str(tmp_path)), "SamModel", "x")
