"""Yaml from outside: what is plain is read, what could mean two things is refused."""

from pathlib import Path

import pytest

from marl_clean.errors import BadInput
from marl_clean.storage.safe_yaml import load_yaml


def loaded(folder: Path, text: str) -> object:
    (folder / "settings.yaml").write_text(text, encoding="utf-8")
    return load_yaml(folder / "settings.yaml")


@pytest.mark.parametrize(
    "text, key",
    [
        ("a: 1\nb: 2\na: 3", "a"),
        ("a: {b: 1, c: 2, b: 1}", "b"),
        ("a: 1\n'a': 1", "a"),
        ("- x: [1]\n  y: {x: 1}\n  x: 2", "x"),
        ("? [1]\n: b\nb: 1\nb: 2", "b"),
        ("a:\n  b: 1\nc: 1\na: {}", "a"),
    ],
)
def test_a_key_that_stands_twice_is_refused(tmp_path: Path, text: str, key: str) -> None:
    with pytest.raises(BadInput, match=f"settings.yaml: the key '{key}' stands twice") as caught:
        loaded(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_the_same_word_elsewhere_is_no_second_key(tmp_path: Path) -> None:
    text = "a: a\nb: {a: 1, b: a}\nc: [a, a, {a: 1}, {a: 1}]"
    expected = {"a": "a", "b": {"a": 1, "b": "a"}, "c": ["a", "a", {"a": 1}, {"a": 1}]}
    assert loaded(tmp_path, text) == expected
