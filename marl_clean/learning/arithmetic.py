"""The arithmetic of encoders: bfloat16 on devices that compute with it, float32 on all others."""

from functools import cache

import torch
from torch import Tensor

from marl_clean.settings import Precision


def reduced_for(observation: Tensor, precision: Precision) -> torch.autocast:
    """Return the context in which an encoder computes from `observation`.

    A CPU without instructions for bfloat16 imitates them, and takes ten times as long as with
    float32, which is therefore what `bfloat16` means there.
    """
    device = observation.device.type
    enabled = precision == "bfloat16" and computes_bfloat16(device)
    return torch.autocast(device, torch.bfloat16, enabled=enabled)


@torch.compiler.assume_constant_result
def computes_bfloat16(device: str) -> bool:
    """Whether a type of device, such as `cpu`, has instructions for products of bfloat16."""
    return _asked(device)  # a function of its own: the compiler would look through the cache


@cache
def _asked(device: str) -> bool:
    if device == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if device == "cpu":
        has = torch.cpu.get_capabilities()
        return any(bool(has.get(name)) for name in ("avx512_bf16", "amx_bf16", "bf16"))
    return True
