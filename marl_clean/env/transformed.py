"""TorchRL's env under transforms, with a shorter path through a step: the same frames."""

from jaxtyping import Bool, Int
from tensordict import TensorDict, TensorDictBase, is_tensor_collection
from torch import Tensor
from torchrl.envs import (
    Compose,
    InitTracker,
    RewardSum,
    TensorDictPrimer,
    Transform,
    TransformedEnv,
)

from marl_clean import keys
from marl_clean.env.channel_seed import ChannelSeed
from marl_clean.env.frames import heard_in
from marl_clean.env.shaping import Shaping
from marl_clean.env.transform import RewardTransform, WorldTransform
from marl_clean.world.step import Along, Entries

KNOWN = (
    WorldTransform,
    RewardTransform,
    Shaping,
    ChannelSeed,
    RewardSum,
    InitTracker,
    TensorDictPrimer,
)
"""Transforms that add entries and leave actions as they are."""


class TransformedWorlds(TransformedEnv):
    """A `CleaningEnv` under transforms: `step_and_maybe_reset` without detours.

    TorchRL's method serves every env: it looks for partial steps and inverse transforms, and for a
    reset it builds a whole batch and uses the rows that ended. Here a world ends as a whole, and
    only the rows that ended are built and put into the carried frame. The result is that of
    TorchRL's own method, to the bit; with other transforms that method is used.
    """

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        worlds, transforms = self.base_env, self.transforms
        usual = tensordict.device == worlds.device and tensordict.batch_size == worlds.batch_size
        known = all(isinstance(transform, KNOWN) for transform in transforms)
        if not usual or not known or "_step" in tensordict:
            return super().step_and_maybe_reset(tensordict)
        adjacency = tensordict.get(keys.ADJACENCY, None)
        along = computed_along(transforms, adjacency)
        after = worlds.step_worlds(tensordict.get(keys.ACTION), along, heard_in(tensordict))
        carried_over = tensordict.get("next", None)  # what a policy carries
        if carried_over is not None:
            after.update(carried_over.exclude(*after.keys(True, True)))
        for transform in transforms:
            if isinstance(transform, WorldTransform):
                is_computed = transform.along
            else:
                is_computed = isinstance(transform, RewardTransform) and along.pay is not None
            if isinstance(transform, RewardSum):  # its own search for keys takes 2 % of a step
                for paid, summed in zip(transform.in_keys, transform.out_keys, strict=True):
                    after.set(summed, tensordict.get(summed, 0.0) + after.get(paid))
            elif not is_computed:
                after = transform._step(tensordict, after)
        tensordict.set("next", after)
        carried = self._step_mdp(tensordict)
        done = after.get(keys.DONE)
        rows = done.view(-1).nonzero()[:, 0]
        if len(rows):
            self.begin_anew(carried, done, rows)
        return tensordict, carried

    @property
    def transforms(self) -> list[Transform]:
        """The transforms, in their order."""
        whole = self.transform
        return list(whole.transforms) if isinstance(whole, Compose) else [whole]

    def set_gamma(self, gamma: float) -> None:
        """Use this discount of the learner's from now on, where rewards are shaped."""
        for transform in self.transforms:
            if isinstance(transform, Shaping):
                transform.gamma = gamma

    def begin_anew(
        self, carried: TensorDictBase, done: Bool[Tensor, "env 1"], rows: Int[Tensor, " row"]
    ) -> None:
        """Put the first frames of new episodes into the rows that are `done`.

        Entries that a first frame lacks, such as those a policy wrote, are 0 there.
        """
        worlds = [t for t in self.transforms if isinstance(t, WorldTransform)]
        fresh, entries = self.base_env.begin_rows(rows, [t.read for t in worlds])
        entries[keys.POSITION] = fresh.position
        for transform in self.transforms:
            if not isinstance(transform, WorldTransform | RewardTransform | RewardSum):
                request = TensorDict({"_reset": done}, self.batch_size, device=self.device)
                first = transform._reset(request, request.empty())
                entries |= {key: first.get(key)[rows] for key in first.keys(True, True)}
        put_rows(carried, rows, entries)


def put_rows(
    frame: TensorDictBase,
    rows: Int[Tensor, " row"],
    entries: Entries,
    above: tuple[str, ...] = (),
) -> None:
    """Put `entries` into the rows of a frame, 0 for keys without one; in new tensors.

    The old tensors may be part of a recorded step.
    """
    for name, before in list(frame.items()):
        if is_tensor_collection(before):
            put_rows(before, rows, entries, (*above, name))
            continue
        fresh = entries.get((*above, name) if above else name)
        if fresh is None:
            after = before.index_fill(0, rows, 0)
        else:
            after = before.index_copy(0, rows, fresh)
        # The shape is unchanged: `set` would check it, for a fifth of this function's time.
        frame._set_str(name, after, validated=True, inplace=False)


def computed_along(
    transforms: list[Transform], adjacency: Bool[Tensor, "env agent agent"] | None
) -> Along:
    """Return what is computed for these transforms in one call with a step, not after it."""
    worlds = (t for t in transforms if isinstance(t, WorldTransform))
    pays = [t.pay for t in transforms if isinstance(t, RewardTransform)]
    pay = pays[-1] if pays and adjacency is not None else None
    return Along([t.read for t in worlds if t.along], pay, adjacency)
