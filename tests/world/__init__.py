"""Tests of the world's rules."""
