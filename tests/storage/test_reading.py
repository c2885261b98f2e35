"""Files from outside: ordinary, of bounded size; JSON of finite values."""

import json
import os
from pathlib import Path

import pytest

from marl_clean.errors import BadInput
from marl_clean.storage.reading import TooLarge, parse_json, read_bytes


def test_a_file_is_read_whole_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(TooLarge, match="a: larger than 4 bytes"):
        read_bytes(path, 4)
    with pytest.raises(BadInput, match="cannot be read: No such file"):
        read_bytes(tmp_path / "b", 4)
    with pytest.raises(BadInput, match="cannot be read: no ordinary file"):
        read_bytes(tmp_path, 4)
    with pytest.raises(BadInput, match="no ordinary file"):
        read_bytes(Path("/dev/zero"), 4)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadInput, match="no ordinary file"):
        read_bytes(tmp_path / "pipe", 4)


def test_plain_json_is_read_as_ever() -> None:
    tree = {"a": [1, -2.5, 1e300, None, True, "ü\U0001f600"], "b": {"c": {}}, "d": -(2**63)}
    for ascii_only in (True, False):
        assert parse_json(json.dumps(tree, ensure_ascii=ascii_only).encode()) == tree
    assert parse_json(b"[" * 100 + b"]" * 100) is not None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"", "Expecting value"),
        (b"NaN", "NaN is no number"),
        (b"[-Infinity]", "-Infinity is no number"),
        (b"1e999", "beyond the range"),
        (b"9" * 21, "longer than a whole number of 64 bits"),
        (b"9" * 5000, "longer than a whole number of 64 bits"),
        (b"[" * 101 + b"]" * 101, "nested more than 100 deep"),
        (b"[" * 100_000, "nested more than 100 deep"),
        (b'{"a": 1, "b": 2, "a": 3}', "the key 'a' stands twice"),
        (b'["\\ud800"]', "surrogates"),
        (b'{"\\udfff": 1}', "surrogates"),
        (b"\xff", "can't decode"),
        (b"[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]", "more than 10 values"),
    ],
    ids=range(13),
)
def test_json_that_would_fail_later_fails_here(text: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as caught:
        parse_json(text, most_values=10 if b"12" in text else 1000_000)
    assert len(str(caught.value)) < 200
