"""Devices of this machine that the measurements of springs and flocks can use."""

from __future__ import annotations

from modalshell.core.errors import OptionError
from modalshell.kernels.device import devices


def missing_devices() -> dict[str, str]:
    """Why Warp, or a GPU for it, cannot be used here; empty where both can."""
    try:
        here = devices()
    except OptionError as error:
        return {"Warp": str(error)}
    return {} if any(device.startswith("cuda") for device in here) else {"Warp, GPU": "no GPU here"}
