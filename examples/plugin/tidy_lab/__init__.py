"""Levels for marl_clean: a scheme, a house and a planner."""
