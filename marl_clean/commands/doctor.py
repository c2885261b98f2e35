"""`marl-clean doctor`: what is installed, what is missing, how to fix it."""

import os
import platform
import sys
from collections.abc import Iterator, Sequence
from importlib import metadata, util

from packaging.requirements import Requirement
from packaging.version import Version

from marl_clean import __version__
from marl_clean.commands._machine import Finding, gpu, machine_findings
from marl_clean.config.levels import conf_folder
from marl_clean.config.locate import own
from marl_clean.errors import BadInput

DISTRIBUTION = "marl-clean"
TESTED = "constraints.txt"  # of a checkout: the versions that figures were measured with


def findings() -> Iterator[Finding]:
    """The state of this installation, what is wrong included."""
    yield Finding("marl-clean", __version__)
    yield Finding("python", f"{platform.python_version()} ({sys.executable})")
    yield _conf()
    yield from _distributions()
    yield from _device()
    yield from machine_findings()


def lines_of(report: Sequence[Finding]) -> list[str]:
    """A line of each finding, its remedy at the end."""
    width = max(len(finding.name) for finding in report)
    remedies = (f"  -> {finding.remedy}" if finding.remedy else "" for finding in report)
    return [
        f"{finding.name:{width}}  {finding.state}{remedy}"
        for finding, remedy in zip(report, remedies, strict=True)
    ]


def _conf() -> Finding:
    try:
        return Finding("config folder", str(conf_folder()))
    except BadInput as error:
        return Finding("config folder", "missing", str(error))


def _distributions() -> Iterator[Finding]:
    """The version of every declared requirement against its range; extras may be missing."""
    try:
        declared = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        yield Finding(DISTRIBUTION, "runs from its folder, not installed", "pip install -e .")
        return
    # A package that several extras require is listed once.
    requirements = {requirement.name: requirement for requirement in map(Requirement, declared)}
    tested = _tested()
    extras = {name: _extra_of(requirement) for name, requirement in requirements.items()}
    for name in sorted(requirements, key=lambda name: (extras[name] or "", name)):
        if name != DISTRIBUTION:
            yield _distribution(requirements[name], extras[name], tested.get(name))


def _tested() -> dict[str, str]:
    """The version of each package that figures were measured with, where this is a checkout."""
    path = own().folder.parent / TESTED
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    pinned = (line.split("==") for line in lines if "==" in line)
    return {name: version.strip() for name, version in pinned}


def _distribution(requirement: Requirement, extra: str | None, tested: str | None) -> Finding:
    wanted = f"{requirement.name}{requirement.specifier}"
    remedy = f"pip install '{wanted}'"
    try:
        version = metadata.version(requirement.name)
    except metadata.PackageNotFoundError:
        state = f"not installed (extra {extra})" if extra else "missing"
        return Finding(wanted, state, "" if extra else remedy)
    fits = requirement.specifier.contains(version, prereleases=True)
    if fits and tested is not None and Version(version).public != tested:
        version += f" (measured with {tested}; pip install '{requirement.name}=={tested}')"
    return Finding(wanted, version, "" if fits else remedy)


def _extra_of(requirement: Requirement) -> str | None:
    """The extra that a requirement belongs to, or None when it is always required."""
    if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
        return None
    extras = metadata.metadata(DISTRIBUTION).get_all("Provides-Extra") or []
    return next((e for e in extras if requirement.marker.evaluate({"extra": e})), None)


def _device() -> Iterator[Finding]:
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    yield Finding("cores", str(cores))
    if util.find_spec("torch") is None:
        return
    import torch

    yield Finding("torch threads", f"{torch.get_num_threads()} (OMP_NUM_THREADS sets them)")
    devices = [
        f"cuda:{i} {torch.cuda.get_device_name(i)}" for i in range(torch.cuda.device_count())
    ]
    devices += ["mps"] if torch.backends.mps.is_available() else []
    yield Finding("devices", ", ".join(["cpu", *devices]))
    if (unseen := gpu(torch.cuda.device_count())) is not None:
        yield unseen

    from marl_clean.learning.arithmetic import computes_bfloat16

    has = "instructions" if computes_bfloat16("cpu") else "none: agent.precision is float32 there"
    yield Finding("bfloat16 on the cpu", has)
