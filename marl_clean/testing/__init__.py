"""The contracts of the rooms: what every level must hold, ours or a plugin's.

    from marl_clean.testing import check_comm

    def test_my_scheme() -> None:
        check_comm("my_scheme", message_dim=8)

    def test_a_level_of_a_plugin_that_is_not_installed() -> None:
        use_plugins(["my_package"])
        check_house("my_house")

Each function takes a level by name, as on the command line, or by its class, and its settings.
It returns nothing where the contract holds, and raises `ContractBroken` with what is broken and on
which numbers. The requirements are listed as `CLAUSES` in the room's module here; each clause is a
function whose docstring is the promise. No contract names a level of ours.
"""

from marl_clean.config.locate import use_plugins
from marl_clean.testing._broken import ContractBroken
from marl_clean.testing.agent import check_agent
from marl_clean.testing.channel import check_channel, check_stack
from marl_clean.testing.comm import check_comm
from marl_clean.testing.encoder import check_encoder
from marl_clean.testing.house import check_house
from marl_clean.testing.observation import check_observation
from marl_clean.testing.planner import check_planner
from marl_clean.testing.reward import check_reward
from marl_clean.testing.topology import check_topology

__all__ = [
    "ContractBroken",
    "check_agent",
    "check_channel",
    "check_comm",
    "check_encoder",
    "check_house",
    "check_observation",
    "check_planner",
    "check_reward",
    "check_stack",
    "check_topology",
    "use_plugins",
]
