"""TorchRL's env under transforms, with a shorter way through a step: the same frames."""

from jaxtyping import Bool, Int
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs import Compose, InitTracker, RewardSum, TensorDictPrimer, TransformedEnv

from marl_clean import keys
from marl_clean.env.channel_seed import ChannelSeed
from marl_clean.env.transform import RewardSplit, WorldTransform
from marl_clean.world.turn import Along, Reader

KNOWN = (WorldTransform, RewardSplit, ChannelSeed, RewardSum, InitTracker, TensorDictPrimer)
"""Transforms that add entries and leave actions as they are."""


class TransformedWorlds(TransformedEnv):
    """A `CleaningEnv` under transforms: `step_and_maybe_reset` without detours.

    TorchRL's way serves every env: it looks for partial steps and inverse transforms, and of a
    reset it makes a whole batch of which it takes the rows that ended. Here a world ends as one,
    and only the rows that ended are made, and put into what is carried on. What comes out is what
    TorchRL's own method gives, to the bit; with other transforms it is that method that plays.
    """

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        worlds, transforms = self.base_env, self.transforms
        usual = tensordict.device == worlds.device and tensordict.batch_size == worlds.batch_size
        known = all(isinstance(one, KNOWN) for one in transforms)
        if not usual or not known or "_step" in tensordict:
            return super().step_and_maybe_reset(tensordict)
        adjacency = tensordict.get(keys.ADJACENCY, None)
        pays = [one.pay for one in transforms if isinstance(one, RewardSplit)]
        along = Along(readers_of(transforms), pays[-1] if pays else None, adjacency)
        after = worlds.play(tensordict.get(keys.ACTION), along)
        carried_over = tensordict.get("next", None)  # what a policy remembers
        if carried_over is not None:
            after.update(carried_over.exclude(*after.keys(True, True)))
        for one in transforms:
            if isinstance(one, WorldTransform):
                done_along = one.reader() is not None
            else:
                done_along = isinstance(one, RewardSplit) and adjacency is not None
            if not done_along:
                after = one._step(tensordict, after)
        tensordict.set("next", after)
        carried = self._step_mdp(tensordict)
        done = after.get(keys.DONE)
        rows = done.view(-1).nonzero()[:, 0]
        if len(rows):
            self.begin_anew(carried, done, rows)
        return tensordict, carried

    @property
    def transforms(self) -> list:
        """The transforms, in their order."""
        whole = self.transform
        return list(whole.transforms) if isinstance(whole, Compose) else [whole]

    def begin_anew(
        self, carried: TensorDictBase, done: Bool[Tensor, "env 1"], rows: Int[Tensor, " row"]
    ) -> None:
        """Put the first frames of new episodes into the rows that are `done`.

        What no first frame has, such as what a policy wrote, is 0 there.
        """
        readers = readers_of(self.transforms, few=True)
        fresh, readings = self.base_env.begin_rows(rows, readers)
        entries: dict[NestedKey, Tensor] = {keys.POSITION: fresh.position, **readings}
        for one in self.transforms:
            if isinstance(one, WorldTransform):
                entries |= {} if one.reader(few=True) else one.read(fresh)
            elif not isinstance(one, RewardSplit | RewardSum):  # whose sums begin at 0
                asked = TensorDict({"_reset": done}, self.batch_size, device=self.device)
                begun = one._reset(asked, asked.empty())
                entries |= {key: begun.get(key)[rows] for key in begun.keys(True, True)}
        for key, before in list(carried.items(True, True)):
            if key in entries:
                carried.set(key, before.index_copy(0, rows, entries[key]))
            else:
                carried.set(key, before.index_fill(0, rows, 0))


def readers_of(transforms: list, *, few: bool = False) -> list[Reader]:
    """Return what transforms have computed along with a step, or with a beginning (`few`)."""
    readers = (one.reader(few=few) for one in transforms if isinstance(one, WorldTransform))
    return [reader for reader in readers if reader is not None]
