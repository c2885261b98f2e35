"""What a run was made with: code, versions, machine. Everything that is not known is null."""

import os
import platform
import subprocess
from contextlib import suppress
from functools import cache
from importlib import metadata
from json import JSONDecodeError, loads
from pathlib import Path
from typing import Any

from marl_clean.config.locate import packages

DISTRIBUTIONS = (
    *("torch", "torchrl", "tensordict", "numpy", "scipy", "numba", "hydra-core", "omegaconf"),
    *("pettingzoo", "mpe2"),
)  # whose version may change a run's result
OURS = "marl_clean"  # as package and, but for a hyphen, as distribution
CPU_INFO = Path("/proc/cpuinfo")
GIT_SECONDS = 20


def code() -> dict[str, dict[str, Any]]:
    """Return the version, git commit and cleanness of this package and of each plugin, by name."""
    return {
        package.name: {"version": version_of(package.name), **git_state(package.folder)}
        for package in packages()
    }


def version_of(package: str) -> str | None:
    """The version of the distribution that an imported package comes from."""
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(_distribution_of(package))
    return None


@cache
def _distribution_of(package: str) -> str:
    """The distribution that a package comes from, its own name where it is not installed.

    To ask for those of all packages reads every file list of the environment, half a second.
    """
    if package == OURS:
        return OURS
    return metadata.packages_distributions().get(package, [package])[0]


def git_state(package: Path) -> dict[str, Any]:
    """Return `commit`, and whether the tree was `clean`: as committed, without untracked files.

    A package installed from git has the commit that pip noted; its files are taken for unchanged.
    """
    # A folder of installed packages may lie in the tree of another project, which does not hold it.
    if _git(package, "ls-files", "--error-unmatch", "__init__.py") is not None:
        commit, changes = _git(package, "rev-parse", "HEAD"), _git(package, "status", "--porcelain")
        return {"commit": commit, "clean": None if changes is None else not changes}
    commit = _commit_of_install(package.name)
    return {"commit": commit, "clean": None if commit is None else True}


def _git(folder: Path, *arguments: str) -> str | None:
    """What git prints; None where it fails or there is none."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            timeout=GIT_SECONDS,
            check=True,
        )
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return None
    return done.stdout.strip()


def _commit_of_install(package: str) -> str | None:
    """The commit in `direct_url.json` (PEP 610) of a package that pip installed from git."""
    distribution = _distribution_of(package)
    with suppress(metadata.PackageNotFoundError, JSONDecodeError, AttributeError, TypeError):
        noted = loads(metadata.distribution(distribution).read_text("direct_url.json") or "{}")
        return noted.get("vcs_info", {}).get("commit_id")
    return None


def versions() -> dict[str, str]:
    """Return the version of Python and of each of `DISTRIBUTIONS` that is installed."""
    installed = {"python": platform.python_version()}
    for name in DISTRIBUTIONS:
        with suppress(metadata.PackageNotFoundError):
            installed[name] = metadata.version(name)
    return installed


def hardware(device: str) -> dict[str, Any]:
    """Return system, processor, cores this process may use, threads of torch, memory, device.

    `bfloat16`: whether the device computes with it, or `agent.precision=bfloat16` is float32.
    """
    import torch

    from marl_clean.learning.arithmetic import computes_bfloat16

    cuda = torch.device(device).type == "cuda"
    return {
        "system": platform.platform(),
        "cpu": cpu_model(),
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        "torch_threads": torch.get_num_threads(),
        "memory_gib": _memory_gib(),
        "device": device,
        "bfloat16": computes_bfloat16(torch.device(device).type),
        "gpu": torch.cuda.get_device_name(device) if cuda else None,
        "cuda": torch.version.cuda if cuda else None,
    }


def cpu_model(cpu_info: Path = CPU_INFO) -> str | None:
    """The processor's name, as Linux has it; elsewhere what Python knows."""
    with suppress(OSError):
        for line in cpu_info.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or None


def _memory_gib() -> float | None:
    with suppress(OSError, ValueError, AttributeError):
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    return None
