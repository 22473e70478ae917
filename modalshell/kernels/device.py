"""Warp, imported on demand, and the devices of this machine."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from modalshell.core.errors import OptionError


def warp() -> ModuleType:
    """The Warp library, started without its banner; OptionError where it is not installed."""
    try:
        import warp as library
    except ImportError as error:
        raise OptionError(f"devices need Warp: pip install 'modalshell[gpu]' ({error})") from error
    library.config.log_level = max(library.config.log_level, library.LOG_WARNING)
    library.init()
    return library


def devices() -> list[str]:
    """Names of devices: "cpu", and "cuda:0" and so on for every GPU that is here."""
    return [device.alias for device in warp().get_devices()]


def device_names() -> dict[str, str]:
    """What makers call the devices of :func:`devices`."""
    return {device.alias: device.name for device in warp().get_devices()}


def checked_device(name: str | None) -> str:
    """Return ``name``, or for None the first GPU and else "cpu"; OptionError for what is not here."""
    known = devices()
    if name is None:
        return next((device for device in known if device.startswith("cuda")), "cpu")
    if name not in known:
        gpus = any(device.startswith("cuda") for device in known)
        fault = "there is no such device" if gpus or not str(name).startswith("cuda") else "no GPU is here"
        raise OptionError(f"{fault}: device must be one of {', '.join(known)} (got {name!r})")
    return name


def device_types(dtype: DTypeLike) -> tuple[Any, Any]:
    """Warp's number and vector of three of a precision, float64 or float32."""
    library = warp()
    real = library.float64 if np.dtype(dtype) == np.float64 else library.float32
    return real, library.types.vector(3, real)
