"""Every TensorDict key, written once, in TorchRL's multi-agent grammar.

`*B` is the batch of environments, `n` the number of robots, `K` the side of the view.
The nested TensorDict `agents` has batch `[*B, n]`; termination stands at the root.
"""

AGENTS = "agents"

OBSERVATION = (AGENTS, "observation")  # *B n ch K K, or *B n d, float32
POSITION = (AGENTS, "position")  # *B n 2 int64, (row, col) in the house
ADJACENCY = (AGENTS, "adjacency")  # *B n n bool, symmetric, false on the diagonal
POTENTIAL = (AGENTS, "potential")  # *B n 1 float32: of shaping, 0 to -60
DISTANCE_RANK = (AGENTS, "distance_rank")  # *B n n int64, 0 itself, 1 the nearest, ...
OFFSET = (AGENTS, "offset")  # *B n n 2 int64, [i, j]: (row, col) from i to j; on demand
TARGET = (AGENTS, "target")  # *B n 3 int64: (row, col) to what it has to clean next, 1; or zeros
PATCH = (AGENTS, "patch")  # *B n 49 int8: a class of each cell around a robot, by its own map
TOLD_PATCH = (AGENTS, "told_patch")  # *B n 49 int8: what is read in each one's message; 0: nothing
TOLD_EDGES = (AGENTS, "told_edges")  # *B n n bool, [i, j]: i reads it of j; a policy's, for the env
TOLD_PLACE = (AGENTS, "told_place")  # *B n 2 int64: (row, col) where each spoke
KNOWN = (AGENTS, "known")  # *B n K K int8: a class of each cell around a robot, by its map
MISSING = (AGENTS, "missing")  # *B n n K K int8, [i, j]: of cells around i, by j's map; -1: i knows
GRAPH = (ADJACENCY, DISTANCE_RANK, OFFSET)  # who may talk to whom, and who is where

ACTION = (AGENTS, "action")  # *B n int64: 0 up, 1 right, 2 down, 3 left
ACTION_MASK = (AGENTS, "action_mask")  # *B n 4 bool: true where an action may be chosen
DEMONSTRATION = (AGENTS, "demonstration")  # *B n int64: a planner's action; -1: none recorded
ACTION_VALUE = (AGENTS, "action_value")  # *B n 4 float32
LOGITS = (AGENTS, "logits")  # *B n 4 float32, of a policy that draws its actions
LOG_PROB = (AGENTS, "action_log_prob")  # *B n float32: of the action drawn
STATE_VALUE = (AGENTS, "state_value")  # *B n 1 float32: a critic's
ADVANTAGE = (AGENTS, "advantage")  # *B n 1 float32
VALUE_TARGET = (AGENTS, "value_target")  # *B n 1 float32
CHOSEN_ACTION_VALUE = (AGENTS, "chosen_action_value")  # *B n 1 float32
TEAM_VALUE = "chosen_action_value"  # *B 1 float32: the robots' chosen values, mixed
JOINT_ACTION = "joint_action"  # *B int64, base 4, robot 0 the lowest digit
JOINT_ACTION_MASK = "joint_action_mask"  # *B 4^n bool: false where any robot's action is masked
JOINT_ACTION_VALUE = "joint_action_value"  # *B 4^n float32
CHOSEN_JOINT_ACTION_VALUE = "chosen_joint_action_value"  # *B 1 float32
MESSAGE = (AGENTS, "message")  # *B n M float32: what each robot sent
MESSAGE_EDGES = (AGENTS, "message_edges")  # *B n K float32: over how many edges, each round
MESSAGE_BITS = (AGENTS, "message_bits")  # *B n 1 float32: what sending it cost

CHANNEL_SEED = (
    AGENTS,
    "channel_seed",
)  # *B n int64 in [0, 2^32): for what channels and policies draw
INBOX = (AGENTS, "inbox")  # *B n age number float32: messages under way, and their receivers
OUTBOX = (AGENTS, "outbox")  # the same, of a scheme whose messages are heard later by definition
BURST = (AGENTS, "burst")  # *B n n bool, [i, j]: the edge from j to i is in a burst of losses
FROZEN = (AGENTS, "frozen")  # *B n number float32: first messages, while evaluation freezes them
LATE = (AGENTS, "late")  # as inbox, while evaluation delays messages
HIDDEN = (AGENTS, "hidden")  # *B n d float32: a recurrent encoder's memory
COMM_HIDDEN = (AGENTS, "comm_hidden")  # *B n d float32: what a scheme carries to the next step
CRITIC_HIDDEN = (AGENTS, "critic_hidden")  # *B n d float32: a critic's memory before a frame
IS_INIT = "is_init"  # *B 1 bool: the first frame of an episode

STATE = "state"  # *B ch R C bool: the truth, for mixers and critics

REWARD = (AGENTS, "reward")  # *B n 1 float32: what the robot is paid
OWN_REWARD = (AGENTS, "own_reward")  # *B n 1 float32: what it earned itself in the last step
INFO_STEP = (AGENTS, "info", "step")  # *B n 1 float32, the three terms of own_reward
INFO_CLEANING = (AGENTS, "info", "cleaning")
INFO_DISCOVERY = (AGENTS, "info", "discovery")
INFO_COLLISION = (AGENTS, "info", "collision")  # another, only with env.collision_pays below 0
INFO_SPILL = (AGENTS, "info", "spill")  # another, only with env.spills.per_episode above 0
INFO_SHAPING = (AGENTS, "info", "shaping")  # part of reward, not of own_reward
EPISODE_REWARD = (AGENTS, "episode_reward")  # *B n 1 float32: sum of reward so far

DONE = "done"  # *B 1 bool
TERMINATED = "terminated"
TRUNCATED = "truncated"
STEPS_TO_NEXT_OBS = "steps_to_next_obs"  # *B int64: length of the n-step window
ENDINGS = (DONE, TERMINATED, TRUNCATED)
