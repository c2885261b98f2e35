"""Commands with bad input, and what the one line about each names.

A script, too: it runs them all in one process, for which torch must not be imported.
"""

import os
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

from marl_clean import cli

# Through the command line for real: (arguments, what the one line names).
BAD_COMMANDS = {
    "trian": "did you mean train?",
    "train house=drawn house.path=nowhere.txt": "house.path",
    "train house=floorplan house.path=broken.yaml": "missing.pgm",
    "train env.n_agents=99": "env.n_agents",
    "train house=drawn house.path=walls.txt": "no free cell",
    "evaluate checkpoint=nowhere": "checkpoint=nowhere",
}
# The same, in one interpreter.
MORE_BAD_COMMANDS = {
    "train --foo": "--foo",
    "train observation.view_size=14": "13 and 15",
    "train env.n_agents=0": "env.n_agents",
    "train observation=distances": "encoder=cnn: takes squares, observation=distances gives a",
    "train encoder=mlp": "valid: cnn",
    "train -m observation=crop,distances": "encoder=cnn",
    "train observation=distances encoder=mlp agent.augment=true": "agent.augment",
    "train observation=global_map house.rows=[5,14]": "observation.largest_side=10",
    "train observation=global_map": "evaluation.plans",
    "evaluate observation=global_map house=drawn": "observation.largest_side=10",
    "train observation.position_noise=1.5": "observation.position_noise",
    "train env.bump_noise=-1": "env.bump_noise",
    "figure paper_2 observation=distances": "observation=distances",
    "benchmark observation=global_map": "observation=global_map",
    "train agent.lr=abc": "agent.lr",
    "train agent.lrr=1": "did you mean lr?",
    "train house=rooms house.rows=[3,3] house.cols=[3,3]": "house.rows",
    "train -m seed=1,x": "seed",
    "train -m seed=interval(0,1)": "seed",
    "train -m comm=glob(x*)": "comm: a sweep needs a list of values",
    "train -m seed=range(1,8,0)": "'seed=range(1,8,0)': cannot be listed; valid: an end, a step",
    "train -m seed=range(0,inf)": "cannot be listed",
    "train -m hydra/launcher=rq": "is not installed; pip install hydra-rq-launcher",
    "train -m hydra/launcher=nope": "hydra/launcher=nope: no such level; valid: basic",
    "train -m hydra.nope=1": "hydra.nope: no such key of Hydra's",
    "train -m hydra.job.nam=x seed=1": "did you mean name?",
    "train -m hydra/launcher=basic,nope": "takes one value",
    "train -m comm=plan,plam": "did you mean plan?",
    "tune seed=1": "tune: nothing is searched; give a key several values",
    "tune agent.lr=interval(-1,1)": "agent.lr: must be a number, more than 0, not -1",
    "tune agent.lrr=interval(1,2)": "did you mean lr?",
    "tune agent.lr=interval(2,1)": "agent.lr=interval(2,1): must go from low to high",
    "tune agent.lr=tag(log,interval(0,1))": "log needs ends above 0",
    "tune agent.lr=tag(lgo,interval(1,2))": "no such tag lgo; valid: log",
    "tune agent.lr=interval(0.1,inf)": "must have two finite ends",
    "tune env.n_agents=interval(0,3)": "env.n_agents: must be a whole number, at least 1",
    "tune env.n_agents=range(3,1)": "0 values; valid: 1 to 1000",
    "tune comm=plan,plam": "did you mean plan?",
    "tune comm=none,plan comm.rounds=1,2": "comm.rounds: no such key",
    "tune device=cpu,cuda": "device: changes no result",
    "tune seed=1,2 tune.trials=0": "tune.trials: must be a whole number, at least 1",
    "tune seed=1,2 tune.trial=1": "tune.trial: no such key; did you mean trials?",
    "tune seed=1,2 tune.seeds=2": "tune.seeds=2: seed is searched itself",
    "tune seed=1,2 tune.measure=T_91": "no such measure; did you mean T_99?",
    "tune seed=1,2 tune.measure=contact": "give tune.direction=minimize or maximize",
    "tune seed=1,2 logger=[tensorboard]": "add csv, as in logger=[csv]",
    "tune seed=1,2 tune.name=../x": "tune.name: must be a folder's name",
    "tune seed=1,2 hydra.job.name=x": "Hydra's own settings are for `train -m`",
    "tune seed=1,2 +experiment=spread tune.measure=T_90": "tune.measure=T_90: no such measure",
    "headroom headroom.side=[8]": "headroom.side: no such key; did you mean sides?",
    "headroom headroom.robots=[1]": "headroom.robots: must be a list, each a whole number, at",
    "headroom headroom.robots=[2,2]": "headroom.robots: 2 stands there twice; once is valid",
    "headroom headroom.reaches=[wide]": "headroom.reaches: must be a list",
    "headroom headroom.reaches=[]": "headroom.reaches",
    "headroom headroom.losses=[1.5]": "headroom.losses",
    "headroom headroom.sides=[3]": "headroom: 3x3, 2 robots: house: in 100 draws",
    "headroom env.n_agents=4": "env.n_agents: headroom plays all that it compares; give headroom.",
    "headroom env.memory=merged": "env.memory: headroom plays all that it compares; leave it out",
    "headroom planner=spiral": "planner=spiral: has no targets to assign; valid: nearest_unknown",
    "headroom topology=none": "topology=none: headroom.reaches sets how far it is; valid: view",
    "headroom channel=delayed": "channel=delayed: headroom sends maps, which it cannot carry",
    "headroom channel=lossy channel.lossy.burst_start=0.1": "burst_start=0.1: headroom keeps no",
    "headroom channel=lossy headroom.losses=[0]": "headroom.losses: channel=lossy says what is",
    "headroom +experiment=spread": "env: an external task has no houses",
    "headroom house=drawn headroom.sides=[8]": "headroom.sides: houses of house=drawn have",
    "headroom out=here.csv": "out=here.csv: must end with .json",
    "train -m +experiment=comm_comparison,quick": "experiment: comm_comparison is a sweep",
    "train evaluation.team_sizes=[2,0]": "evaluation.team_sizes",
    "train observation=compass": "observation=compass gives a vector; valid: mlp",
    "train observation=compass encoder=mlp observation.view_size=1": "observation.view_size",
    "train +experiment=spread observation=compass": "observation=compass: env=pettingzoo shows",
    "train evaluation.sides=[10,2]": "evaluation.sides: 2: ",
    "train +experiment=spread evaluation.sides=[10]": "an external task; valid: []",
    "train evaluation.team_sizes=[99]": "evaluation.team_sizes: 99: ",
    "train -m evaluation.team_sizes=[99] seed=1,2": "evaluation.team_sizes: 99: ",
    "train +experiment=paper_central evaluation.team_sizes=[3]": "agent=central_dqn is of env.n",
    "train +experiment=spread evaluation.team_sizes=[3]": "an external task; valid: []",
    "train -m agent.lr=1,2 sed=3": "did you mean seed?",
    "train encoder.channels=[1,2]": "encoder.strides: 3 strides for 2 convolutions",
    "train encoder.kernel_size=99": "encoder.channels: a view of 15 is too small",
    "train trainer.frames_per_batch=100": "a multiple of env.num_envs=128, such as 128",
    "train trainer.buffer_frames=1": "trainer.buffer_frames=1: must hold at least",
    "train agent=ippo trainer=on_policy trainer.minibatch_frames=3": "must divide",
    "train parameter_budget=1": "parameter_budget=1: the encoder's convolutions have",
    f"train name={'n' * 300}": "name: must be at most 200 characters, not 300",
    f"evaluate checkpoint={'c' * 5000}": "checkpoint=ccc",
    f"evaluate checkpoint={'c' * 300}": "checkpoint=ccc",
    "train encoder.hidden=[999999999]": "encoder.hidden",
    "train comm.message_dim=999999999": "comm.message_dim",
    "train trainer.buffer_frames=2000000000": "trainer.buffer_frames",
    "train observation.view_size=1000001": "observation.view_size=1000001: what all robots see",
    "train -m observation.view_size=15,1000001": "observation.view_size=1000001: what all robots",
    "evaluate planner=random observation.view_size=9999999": "valid: at most",
    "watch observation=pyramid observation.view_size=9999999": "observation.view_size",
    "figure houses observation.view_size=9999999": "observation.view_size",
    "benchmark observation.view_size=9999999": "observation.view_size",
    "train env.num_envs=1000000 trainer.frames_per_batch=1000000 observation.view_size=4001": (
        "observation.view_size=4001: what all robots see takes"
    ),
    "train trainer.buffer_frames=99999999 observation.view_size=255": "trainer.buffer_frames",
    "train agent=ippo trainer=on_policy trainer.frames_per_batch=2147483520": "frames_per_batch=",
    "train logger.csv._target_=marl_clean.logger.base.Logger": "logger.csv._target_: must name",
    "evaluate planner=random house.rows=[999,999] house.cols=[999,999]": "pieces of furniture",
    "train house.rows=14": "house.rows: must be a range, not 14; give [14, 14] or two numbers",
    "evaluate out=.": "out=.",
    "evaluate out=walls.txt/x.json": "walls.txt",
    "evaluate env.n_agents=99": "env.n_agents",
    "watch planner=nobody": "planner=nobody",
    "figure": "NAME",
    "figure seed=1": "name a figure",
    "figure paper_9": "paper_2",
    "benchmark seed=x": "seed",
    "train +experiment=quick_study": "is a study of several arms; marl-clean study quick_study",
    "train -m +experiment=quick_study,quick": "is a study of several arms",
    "study": "NAME",
    "study seed=1": "name a preset",
    "study quik_study": "no such preset; did you mean quick_study?",
    "study quick": "has no section `study`; did you mean quick_study?",
    "study quick_study seed=1": "seed: is what sets the runs of a study apart",
    "study quick_study comm=dgn": "comm: is what sets the runs of a study apart",
    "study quick_study agent.lr=x": "study.arms.silent: agent.lr",
    "study quick_study hydra/launcher=nope": "hydra/launcher=nope: no such level",
    "list seed=1": "seed=1",
    "doctor now": "now",
    "runs --state finshed": "no such state; did you mean finished?",
}


def write_plans() -> None:
    """Write two plans that cannot be used into the working directory."""
    Path("walls.txt").write_text("####\n####\n")
    Path("broken.yaml").write_text(
        "image: missing.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


def complaint(command: str, named: str) -> str:
    """What is wrong with how a command is refused; empty if nothing is."""
    files = set(os.listdir())
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        code = cli.main(command.split())
    text = err.getvalue()
    is_one_line = text.startswith("marl-clean: ") and text.count("\n") == 1 and named in text
    if code == cli.BAD_INPUT and is_one_line and not out.getvalue() and files == set(os.listdir()):
        return ""
    return f"{command[:100]}: {code}, {out.getvalue()!r}, {text!r}, {os.listdir()}"


def main() -> None:
    commands = {**BAD_COMMANDS, **MORE_BAD_COMMANDS}
    complaints = filter(None, (complaint(*command) for command in commands.items()))
    assert not (wrong := "\n".join(complaints)), wrong
    assert "torch" not in sys.modules


if __name__ == "__main__":
    main()
