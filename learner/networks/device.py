"""Finds the device that the engine computes on."""

import torch

from eia_sec.common.errors import ConfigError


def usable_device(name: str) -> torch.device:
    """Return the device of this name.

    Args:
        name: cpu, cuda or cuda:NUMBER.

    Raises:
        ConfigError: this machine or this build of torch has no such device.
    """
    device = torch.device(name)
    if device.type == "cuda":
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if count == 0:
            raise ConfigError(f"learner.device is {name}, and torch {torch.__version__} finds no CUDA device here.")
        if (device.index or 0) >= count:
            raise ConfigError(f"learner.device is {name}, and the last CUDA device here is cuda:{count - 1}.")
    return device


def product_dtype(precision: str, device: str) -> torch.dtype:
    """Return what hidden layers multiply on a device: `precision`, or float32 where bfloat16 would be slower."""
    return torch.bfloat16 if precision == "bfloat16" and has_bfloat16(device) else torch.float32


def has_bfloat16(name: str) -> bool:
    """Return whether a device has instructions for products of bfloat16; without them, they are slower than float32."""
    if torch.device(name).type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    native = getattr(torch.cpu, "_is_avx512_bf16_supported", None)
    return native is not None and bool(native())
