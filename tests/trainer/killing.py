"""A run that is killed in the middle, as kill -9 does it."""

from torchrl.envs import TransformedEnv


class Killed(BaseException):
    """Ends a run without a chance to save."""


def kill_after(env: TransformedEnv, steps: int) -> None:
    """Let the env raise Killed in the step after so many."""
    step_worlds, done = env.base_env.step_worlds, 0

    def dying(*arguments):
        nonlocal done
        done += 1
        if done > steps:
            raise Killed
        return step_worlds(*arguments)

    env.base_env.step_worlds = dying
