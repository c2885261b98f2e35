"""What schemes are whose receivers read in messages what lies around their senders."""

from abc import abstractmethod
from typing import ClassVar

from jaxtyping import Float, Int8
from torch import Tensor

from marl_clean.comm.base import Comm


class Decoding(Comm):
    """Features cross no edge: policies hand what is read to the env, which shows it in maps.

    Attributes:
        reads: the entry of frames that is sent: `patch`, see `marl_clean.env.own_patch`.
        reconstruct: weight of `code_loss`.
    """

    exchanges: ClassVar[str] = "codes"
    decodes: ClassVar[bool] = True
    reads: ClassVar[str] = "patch"
    detach = True

    @property
    def hops(self) -> int:
        """What is said is seen with the next step."""
        return 0

    @abstractmethod
    def patch_of(
        self, heard: Float[Tensor, "*batch agent message"]
    ) -> Int8[Tensor, "*batch agent cell"]:
        """Return what receivers read in the last round's messages, as they arrived.

        A class for each of the cells around each sender, see `marl_clean.world.patches`; nothing in
        a message of zeros.
        """

    @abstractmethod
    def code_loss(self, read: Int8[Tensor, "*batch agent cell"]) -> Float[Tensor, ""]:
        """Return the loss that the code is learnt from, of what each robot knows around itself."""
