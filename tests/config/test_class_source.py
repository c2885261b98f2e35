"""What is read of a class without importing it, of its own and of its bases."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from marl_clean.config import class_source, locate
from marl_clean.config.class_source import constant, parameters, records, takes
from marl_clean.errors import BadInput
from marl_clean.settings import Form, PositiveInt

Write = Callable[..., str]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Write]:
    """Write modules of a package of somebody else's; return the target of the class `Level`."""
    package = locate.Package("theirs", tmp_path / "theirs", tmp_path / "conf")
    monkeypatch.setattr(locate, "packages", lambda: (locate.own(), package))

    def written(text: str, **others: str) -> str:
        package.folder.mkdir(exist_ok=True)
        for name, content in {"level": text, **others}.items():
            (package.folder / f"{name}.py").write_text(content)
        return "theirs.level.Level"

    yield written
    for cached in (class_source._parse, class_source._imports):
        cached.cache_clear()


FITS = "{'trainer': ['off_policy']}"
READABLE = {
    "bare": f"class Level:\n    fits = {FITS}",
    "annotated": f"class Level:\n    fits: ClassVar = {FITS}",
    "annotated with a type": f"class Level:\n    fits: ClassVar[dict[str, list]] = {FITS}",
    "of a base in the same file": f"class Base:\n    fits = {FITS}\nclass Level(Base): ...",
    "of the second base": f"class A: ...\nclass B:\n    fits = {FITS}\nclass Level(A, B): ...",
    "of an imported base": "from theirs.base import Base\nclass Level(Base): ...",
    "under another name": "from theirs.base import Base as Old\nclass Level(Old): ...",
    "imported from beside it": "from .base import Base\nclass Level(Base): ...",
    "by its module": "from theirs import base\nclass Level(base.Base): ...",
    "by its whole name": "import theirs.base\nclass Level(theirs.base.Base): ...",
    "of a generic base": "from theirs.base import Base\nclass Level(Base[int]): ...",
    "past a declaration": (
        "from theirs.base import Base\nclass Level(Base):\n    fits: ClassVar[dict]"
    ),
}


@pytest.mark.parametrize("case", READABLE)
def test_a_constant_is_read_however_it_is_written(write: Write, case: str) -> None:
    target = write(READABLE[case], base=f"class Base:\n    fits: ClassVar = {FITS}\n")
    assert constant(target, "fits") == {"trainer": ["off_policy"]}
    assert constant(target, "sized_by") is None


UNREADABLE = {
    "a call": ("class Level:\n    fits = make()", 2),
    "a name of the file": ("FITS = {}\nclass Level:\n    fits = FITS", 3),
    "under a condition": ("class Level:\n    if 1:\n        fits = {}", 2),
    "one of several": ("class Level:\n    fits, gives = {}, 1", 2),
    "a property": ("class Level:\n    @property\n    def fits(self): ...", 3),
    "an augmented one": ("class Level:\n    fits |= {}", 2),
    "a base that is a call": ("class Level(make()): ...", 1),
    "a base that is a variable": ("Base = make()\nclass Level(Base): ...", 2),
}


@pytest.mark.parametrize("case", UNREADABLE)
def test_what_cannot_be_read_is_an_error_with_class_and_line(write: Write, case: str) -> None:
    text, line = UNREADABLE[case]
    with pytest.raises(BadInput, match=rf"^theirs\.level\.Level, line {line}: .*cannot be read"):
        constant(write(text), "fits")


def test_constants_may_be_false_or_null_or_of_settings(write: Write) -> None:
    target = write("class Level:\n    a = False\n    b = None\n    gives: ClassVar = Form.VECTOR")
    values = [constant(target, name) for name in ("a", "b", "gives")]
    assert values == [False, None, Form.VECTOR]


def test_parameters_are_those_of_the_nearest_constructor(write: Write) -> None:
    target = write(
        "class A:\n    def __init__(self, houses: Houses, *, width: PositiveInt = 3): ...\n"
        "class Level(A):\n    depth = 1\n"
    )
    assert list(parameters(target)) == ["width"]
    assert parameters(target)["width"] == class_source.Parameter(PositiveInt, False)
    assert takes(target, "houses") and not takes(target, "depth")


def test_a_record_stands_for_its_fields_and_another_dataclass_does_not(write: Write) -> None:
    target = write(
        "from theirs.record import Old, Limits\n"
        "class Level:\n"
        "    def __init__(self, old: Old, limits: Limits = Limits(), n: int = 1): ...\n",
        record=(
            "@dataclass\nclass Old:\n    names: list[str]\n"
            "@dataclass\nclass Most:\n    most: int = 9\n"
            "@dataclass\nclass Limits(Most):\n    least: int = 1\n"
            "    made: int = field(init=False)\n    inner: Inner = 3\n    all: ClassVar[int] = 1\n"
        ),
    )
    assert sorted(parameters(target)) == ["least", "most", "n"]
    [(name, record)] = records(target).items()
    assert (name, record.target) == ("limits", "theirs.record.Limits")
    assert record.fields == {"least", "most", "inner"}


@pytest.mark.parametrize("target", ["os.system", "theirs", "theirs.none.Level", "theirs.level.No"])
def test_what_is_no_class_of_the_packages_is_refused(write: Write, target: str) -> None:
    write("class Level: ...")
    with pytest.raises(BadInput, match=f"^'{target}'.*no (file|class)"):
        parameters(target)
