"""Settings: what is accepted, what is refused in which words, and what a run is called."""

import typing
from pathlib import Path

import pytest
import yaml
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from marl_clean import settings
from marl_clean.config import class_source, levels, schema, sections
from marl_clean.config.compose import checked, compose_config, resolved
from marl_clean.config.config_hash import config_hash
from marl_clean.config.overrides import parse_overrides
from marl_clean.config.stored import check_same_run, compose_for_policy
from marl_clean.errors import BadInput
from tests.families import family


def keys_and_types(config: DictConfig) -> dict[str, typing.Any]:
    """Every key a user can set, with the type its constructor declares."""
    types = dict(typing.get_type_hints(sections.Root, include_extras=True))
    evaluation = typing.get_type_hints(sections.Evaluation, include_extras=True)
    types |= {f"evaluation.{name}": annotation for name, annotation in evaluation.items()}
    of_rooms = {room: config[room] for room in levels.rooms() if room not in levels.SEVERAL}
    for room in levels.SEVERAL:
        of_rooms |= {f"{room}.{name}": section for name, section in config[room].items()}
    for name, section in of_rooms.items():
        accepted = class_source.parameters(section["_target_"])
        types |= {f"{name}.{key}": accepted[key].annotation for key in section if key in accepted}
    return types


def wrong_value(annotation: typing.Any) -> str:
    """A value that no key of this type can take."""
    return "[{}]" if schema.mismatch("wrong", annotation) is None else "wrong"


COLOUR = "house.free_colours=[[32,115,185]]"
CONFIG = compose_config()
KEYS = keys_and_types(CONFIG)
WRONG_TYPE = [f"{key}={wrong_value(annotation)}" for key, annotation in KEYS.items()]
MISSPELT = {key.rpartition(".")[0]: f"{key}x=1" for key in KEYS}.values()  # one a section
WRONG_LEVEL = [f"{room}=nowhere" for room in [*levels.rooms(), *levels.PRESETS]]
OUT_OF_RANGE = [
    "seed=-1",
    "seed=1.5",
    "seed=true",
    "seed='1'",
    "seed=",
    "seed=1e99",
    "seed=9999999999",
    "seed=null",
    "device=gpu",
    "name=../elsewhere",
    "name=/tmp/elsewhere",
    "evaluation.epsilon=1.5",
    "evaluation.epsilon=nan",
    "evaluation.houses=0",
    "evaluation.houses=10001",
    "evaluation.house_set=train",
    "env.n_agents=0",
    "env.n_agents=-2",
    "env.n_agents=2.5",
    "env.memory=share",
    "env.stuck_after=0",
    "env.compile=1",
    "house.rows=10",
    "house.rows=[10]",
    "house.rows=[10,5]",
    "house.rows=[0,5]",
    "house.rows=[1,2,3]",
    "house.rows=[5,99999]",
    "observation.view_size=14",
    "observation.view_size=0",
    "comm._target_=os.system",
    "comm._target_=marl_clean.cli.main",
    "comm._target_=marl_clean.comm.none.Nothing",
    "comm._target_=marl_clean.comm.nofile.Nothing",
    "comm._target_=5",
    "comm=null",
    "comm=[plan,none]",
    "logger=null",
    "logger=[csv,fax]",
    "evaluation=5",
    "evaluation={epsilonn: 1}",
    "comm={message_dim: 3}",
]


def refusal(*overrides: str) -> str:
    """The message that a config is refused with."""
    with pytest.raises(BadInput) as caught:
        compose_config(overrides)
    return str(caught.value)


@family("override", WRONG_TYPE, fast=30)
def test_every_key_refuses_what_is_not_of_its_type(override: str) -> None:
    """In a config that is composed already, since Hydra leaves types to the check."""
    config = CONFIG.copy()
    with pytest.raises(BadInput) as caught:
        [parsed] = parse_overrides([override])
        OmegaConf.update(config, parsed.key, parsed.value)
        checked(resolved(config), [parsed])
    assert_names_its_key(str(caught.value), override)


@family("override", [*WRONG_TYPE[::10], *WRONG_LEVEL, *OUT_OF_RANGE], fast=8)
def test_a_wrong_value_names_its_key_and_what_is_valid(override: str) -> None:
    assert_names_its_key(refusal(override), override)


def assert_names_its_key(message: str, override: str) -> None:
    assert message.startswith(override.partition("=")[0])
    assert "\n" not in message
    assert any(word in message for word in ("must", "valid", "no class", "no file", "one by one"))


@family("override", MISSPELT)
def test_a_misspelt_key_is_refused_with_the_nearest_one(override: str) -> None:
    key = override.partition("=")[0]
    assert refusal(override).startswith(f"{key}: no such key; did you mean ")


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("seed", "write KEY=VALUE"),
        ("=3", "write KEY=VALUE"),
        ("a b=3", "cannot read"),
        ("house.path=a(b", "quote special characters"),
        ("+seed=3", "not added"),
        ("++seed=3", "not added"),
        ("~seed", "not added, moved or deleted"),
        ("house@env=rooms", "not added, moved"),
        ("hydra.sweep.dir=x", "train -m"),
        ("hydra/launcher=basic", "train -m"),
        ("seed=1,2", "train -m"),
        ("seed=range(3)", "train -m"),
        ("seed=${nothing}", "not found"),
        ("name='${eval:1}'", "Unsupported interpolation"),
        ("comm=nome", "did you mean none?"),
        ("comm.message_dimm=3", "did you mean message_dim?"),
        ("env.memory=merge", "did you mean merged?"),
        ("observation.view_size=14", "13 and 15"),
        ("seed.x=3", "did you mean seed?"),
    ],
)
def test_what_is_no_setting_is_refused_in_plain_words(override: str, words: str) -> None:
    assert words in refusal(override)


def test_of_two_problems_that_of_an_overridden_key_is_named() -> None:
    # topology.view_size follows observation.view_size, so both are wrong
    assert refusal("observation.view_size=wrong").startswith("observation.view_size")


@pytest.mark.slow
@pytest.mark.parametrize("override", ["experiment={}", "+experiment={}"])
def test_a_preset_may_have_a_plus_or_not(override: str) -> None:
    preset = sorted((levels.conf_folder() / "experiment").glob("*.yaml"))[0].stem
    assert compose_config([override.format(preset)]).name.startswith(f"{preset}-")


def test_a_string_is_not_a_list_of_settings() -> None:
    with pytest.raises(BadInput, match=r"^'env.n_agents=3' is one text; give a list of settings"):
        compose_config("env.n_agents=3")


def test_an_int_is_a_float_but_a_bool_is_no_int() -> None:
    assert schema.mismatch(1, float) is None
    assert schema.mismatch(True, int) is not None
    assert schema.mismatch("1", int) is not None
    assert schema.mismatch("shared", settings.Memory) is None


@pytest.mark.slow
def test_no_logger_is_a_choice() -> None:
    assert compose_config(["logger=[]"]).logger == {}
    assert list(compose_config(["logger=[csv]"]).logger) == ["csv"]


@pytest.mark.slow
def test_instantiate_gives_declared_types_and_lets_parts_win() -> None:
    house = schema.instantiate(compose_config(["house=open"]).house, cols=[3, 4])
    assert (house.rows, house.cols) == ([10, 10], [3, 4])


@pytest.mark.slow
def test_the_hash_covers_what_decides_a_result_and_nothing_else() -> None:
    plain = config_hash(CONFIG)
    same = ["device=cuda", "name=other", "logger=[]", "out=x.json", "checkpoint=y"]
    assert {config_hash(compose_config([override])) for override in same} == {plain}
    other = ["seed=1", "comm=none", "env.n_agents=3", "evaluation.houses=5"]
    assert len({plain, *(config_hash(compose_config([override])) for override in other)}) == 5


def test_the_hash_is_sha256_of_sorted_compact_json() -> None:
    section = DictConfig({"b": 1, "a": {"d": None, "c": [1.5]}, "device": "cpu"})
    assert config_hash(section)[:8] == "87ca00a9"


def test_the_default_name_is_run_and_eight_digits() -> None:
    assert CONFIG.name == f"run-{config_hash(CONFIG)[:8]}"
    assert compose_config(["name=mine"]).name == "mine"


@pytest.mark.slow
def test_composing_works_inside_another_hydra_program(tmp_path: Path) -> None:
    (tmp_path / "theirs.yaml").write_text("a: 1")
    with initialize_config_dir(str(tmp_path), version_base="1.3"):
        assert compose_config().name == CONFIG.name
        assert hydra_compose("theirs") == {"a": 1}


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run folder with its config, in runs/ of an otherwise empty working directory."""
    monkeypatch.chdir(tmp_path)
    folder = Path("runs/mine")
    folder.mkdir(parents=True)
    OmegaConf.save(compose_config(["name=mine", "env.n_agents=3"]), folder / "config.yaml")
    return folder


@pytest.mark.slow
def test_a_checkpoint_brings_its_config_and_settings_go_on_top(run: Path) -> None:
    config = compose_for_policy(["checkpoint=mine", "house=open", "house.rows=[3,7]", "seed=5"])
    assert (config.name, config.env.n_agents, config.seed) == ("mine", 3, 5)
    assert (config.house.rows, config.house.cols) == ([3, 7], [10, 10])
    assert compose_for_policy([f"checkpoint={run}"]).env.n_agents == 3


@pytest.mark.slow
def test_noise_on_what_is_seen_fits_any_weights(run: Path) -> None:
    config = compose_for_policy(["checkpoint=mine", "observation.position_noise=0.1"])
    assert config.observation.position_noise == 0.1


@family(
    "override",
    ["observation.view_size=13", "comm=none", "comm.message_dim=3", "encoder.dropout=1"],
    fast=2,
)
def test_a_setting_that_changes_the_network_does_not_fit(run: Path, override: str) -> None:
    with pytest.raises(BadInput, match="does not fit checkpoint mine") as caught:
        compose_for_policy(["checkpoint=mine", override])
    assert str(caught.value).startswith(override.partition("=")[0])


@family(
    ("overrides", "words"),
    [
        (["checkpoint=mime"], "did you mean mine"),
        (["checkpoint=."], "give the folder of a run"),
        (["checkpoint=mine", "sed=1"], "did you mean seed"),
        (["checkpoint=mine", "env.n_agents=x"], "env.n_agents: must be"),
        (["checkpoint=mine", "experiment=null"], "leave one of them out"),
    ],
    fast=2,
)
def test_a_checkpoint_is_named_rightly(run: Path, overrides: list[str], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        compose_for_policy(overrides)


@family(
    ("text", "words"),
    [
        ("seed: ${oc.env:HOME}", "values written out"),
        ("seed: &a 1", "anchor"),
        ("comm: {_target_: os.system}", "must name the class of a level of comm"),
        ("seed: !!python/object/apply:os.system [ls]", "not plain yaml"),
        ("sed: 1", "no such key"),
        ("seed: [", "not plain yaml"),
        ("seed: " + "[" * 3000, "not plain yaml"),
        ("seed: " + "1" * 2_000_000, "larger than 1 MiB"),
    ],
    fast=3,
)
def test_an_untrusted_config_is_refused(run: Path, text: str, words: str) -> None:
    file = run / "config.yaml"
    plain = OmegaConf.to_container(OmegaConf.load(file))
    assert isinstance(plain, dict)
    plain.pop(text.partition(":")[0], None)
    file.write_text(f"{yaml.safe_dump(plain)}\n{text}\n")
    with pytest.raises(BadInput, match=words) as caught:
        compose_for_policy(["checkpoint=mine"])
    assert str(caught.value).startswith(str(file))


@pytest.mark.slow
def test_a_name_is_not_used_for_two_configs(run: Path) -> None:
    check_same_run(compose_config(["name=mine", "env.n_agents=3", "device=cuda"]), run)
    with pytest.raises(BadInput, match="env.n_agents=3, not 2"):
        check_same_run(compose_config(["name=mine"]), run)


@pytest.mark.slow
def test_a_later_key_of_a_level_counts_where_it_has_a_value() -> None:
    plan = compose_config(["house=floorplan", "house.path=apartment"])
    named = compose_config(["house=floorplan", "house.path=apartment", COLOUR])
    assert config_hash(plan)[:8] == "a764d218"  # as before there was house.free_colours
    assert config_hash(named) != config_hash(plan)


@family("value", ["[]", "[[]]", "[[1,2]]", "[[1,2,256]]", "[[1,2,-3]]"], fast=2)
def test_an_invalid_colour_is_refused_with_a_valid_example(value: str) -> None:
    plan = ["house=floorplan", "house.path=apartment"]
    with pytest.raises(BadInput, match=r"house.free_colours: must be colours \[red, green, blue\]"):
        compose_config([*plan, f"house.free_colours={value}"])
    with pytest.raises(BadInput, match="house.free_colours: must be a list, each a list"):
        compose_config([*plan, "house.free_colours=[1,2,3]"])
