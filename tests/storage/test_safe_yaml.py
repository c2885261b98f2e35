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


def test_texts_numbers_bools_and_null_are_all_that_is_built(tmp_path: Path) -> None:
    text = "a: 2020-01-01\nb: 1.5\nc: [1, true, null, 0x1f, no]\nd: <<\n'1': =\ne: 1_000"
    expected = {"a": "2020-01-01", "b": 1.5, "c": [1, True, None, 31, False], "d": "<<"}
    assert loaded(tmp_path, text) == expected | {"1": "=", "e": 1000}


@pytest.mark.parametrize(
    "text, reason",
    [
        ("seed: !!set {a}", "not plain yaml, the tag 'tag:yaml.org,2002:set'"),
        ("seed: !!timestamp 2020-01-01", "not plain yaml, the tag"),
        ("a: !!binary aGk=", "not plain yaml, the tag"),
        ('a: !!int ""', "not plain yaml, the tag"),
        ("a: !x 1", "not plain yaml, the tag '!x'"),
        ("a: 0x" + "f" * 100_000, "a whole number longer than 64 bits"),
        ("a: " + "9" * 5000, "a whole number longer than 64 bits"),
        ("1: 2", "the key 1 is no text; write it in quotes"),
        ("a: [{null: 2}]", "the key None is no text"),
        ("b" * 101 + ": 1", "the key 'b.*' is longer than 100"),
        ("? [1]\n: 2", "not plain yaml"),
        ("- 1\n" * 40_000, "more than 30,000 values"),
        ('a: "\\ud800"', "not plain yaml"),
        ("\xff", "not plain yaml"),
    ],
    ids=range(14),
)
def test_what_no_setting_is_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "settings.yaml").write_bytes(text.encode("latin-1"))
    with pytest.raises(BadInput, match=f"settings.yaml: .*{reason}") as caught:
        load_yaml(tmp_path / "settings.yaml")
    assert len(str(caught.value)) < 300
