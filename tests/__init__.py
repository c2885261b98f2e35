"""Tests, one folder a room; `reference.py` is the plain-Python world they compare with."""
