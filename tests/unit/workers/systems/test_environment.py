"""Environments of Gymnasium: what they become as systems, where parameters are set, and what is refused."""

import hashlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from perfbound.schemas.errors import CampaignError, DefinitionError, SimulationError
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.system_check import Acts
from perfbound.workers.systems.base import SystemUnderTest
from perfbound.workers.systems.environment import load_environment
from perfbound.workers.systems.policy import load_policy

CAMPAIGN = """
specification = "always (SIGNAL <= 1)"
horizon = 2
falsify = {}
max_tests = 10
[system]
gymnasium = "ID"
policy = "policy.py:act"
KEYS
[space]
SPACE
"""
ACTS = "def act(observation):\n    return int(observation[2] > 0)\n"
WALK = """
import gymnasium
import numpy as np

class Walk(gymnasium.Env):
    observation_space = gymnasium.spaces.Dict(
        {"Own place": gymnasium.spaces.Box(-9, 9, (2,)), "lane": gymnasium.spaces.Discrete(3)}
    )
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, slope=1):
        self.slope, self.width, self.title = slope, 3, "walk"
        self.config = {"speed": 0.5, "policy_frequency": 4}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        options = options or {}
        self.config.update(options.get("config", {}))
        self.at, self.t = options.get("from", 0.0) + self.np_random.random(), 0
        return self.seen(), {"clock": 0.0}

    def seen(self):
        return {"Own place": np.array([self.at, len(range(self.width))], dtype=np.float32), "lane": 1}

    def step(self, action):
        if self.t >= BREAKS:
            raise RuntimeError("it is over")
        self.t += 1
        self.at += self.config["speed"] * self.slope
        return self.seen(), -1.0, self.t == 3, False, {"clock": self.t / 4, "far": self.at > 2, "word": "w"}

gymnasium.register("Walk-v0", entry_point=Walk)
"""

Make = Callable[..., SystemUnderTest]


@pytest.fixture
def environment(tmp_path: Path) -> Make:
    """Make a system of a campaign file; a policy and an environment lie beside it."""

    def make(
        named: str, space: str, keys: str = "", *, policy: str = ACTS, signal: str = "reward", breaks: int = 99
    ) -> SystemUnderTest:
        (tmp_path / "policy.py").write_text(policy)
        (tmp_path / "walk.py").write_text(WALK.replace("BREAKS", str(breaks)))
        text = CAMPAIGN
        for word, value in {"ID": named, "KEYS": keys, "SPACE": space, "SIGNAL": signal}.items():
            text = text.replace(word, value)
        return load_environment(tmp_path / "c.toml", parse_campaign(text.encode(), "c.toml"))

    return make


def rolled(system: SystemUnderTest, *x: float, seed: int = 7, horizon: float = 2.0) -> Any:
    arguments: Mapping[str, Any] = {"variant": "nominal", "horizon": horizon, "options": {}}
    return system.rollout(x, seed=seed, progress=lambda _: None, **arguments)


WALKS = "def act(observation):\n    return 0\n"


def test_the_spec_follows_from_the_environment_and_the_file(environment: Make) -> None:
    spec = environment("CartPole-v1", "length = { low = 0.4, high = 0.6, unit = 'm' }").spec
    assert [(each.name, each.low, each.high, each.unit) for each in spec.parameters] == [("length", 0.4, 0.6, "m")]
    names = ("t", "obs_0", "obs_1", "obs_2", "obs_3", "reward", "ended")
    assert tuple(each.name for each in spec.columns) == names
    assert (spec.name, spec.noisy, spec.after_end, spec.default_horizon) == ("cartpole-v1", ("nominal",), None, 2.0)
    assert set(spec.code) == {"policy.py"}
    assert {"gymnasium", "numpy"} <= set(spec.versions)


def test_an_episode_is_that_of_the_environment(environment: Make) -> None:
    import gymnasium

    system = environment("CartPole-v1", "length = [0.4, 0.6]")
    found = rolled(system, 0.45, horizon=0.2)
    env = gymnasium.make("CartPole-v1")
    seen, _ = env.reset(seed=7)
    env.unwrapped.length = 0.45  # type: ignore[attr-defined]
    expected = [seen]
    for _ in range(10):
        expected.append(env.step(int(expected[-1][2] > 0))[0])
    assert np.array_equal(found.samples[:, 1:5], np.array(expected, dtype=np.float64))
    assert np.allclose(found.column("t"), 0.02 * np.arange(11), rtol=0, atol=1e-12)
    assert np.array_equal(rolled(system, 0.45, horizon=0.2).samples, found.samples), "nothing is left of a rollout"
    assert not np.array_equal(rolled(system, 0.55, horizon=0.2).samples, found.samples)
    assert not np.array_equal(rolled(system, 0.45, seed=8, horizon=0.2).samples, found.samples)


def test_the_horizon_and_no_limit_of_steps_ends_an_episode(environment: Make) -> None:
    assert len(rolled(environment("CartPole-v1", "length = [0.4, 0.6]"), 0.5, horizon=11.0).samples) == 551


def test_names_of_the_file_are_those_of_the_observation_in_its_order(environment: Make) -> None:
    keys = 'columns = { x = "m", v = "m/s", angle = "rad", rate = "rad/s", reward = "" }'
    spec = environment("CartPole-v1", "length = [0.4, 0.6]", keys, signal="angle").spec
    units = [("x", "m"), ("v", "m/s"), ("angle", "rad"), ("rate", "rad/s"), ("reward", "")]
    assert [(each.name, each.unit) for each in spec.columns[1:-1]] == units
    some = environment("CartPole-v1", "length = [0.4, 0.6]", 'columns = { obs_2 = "rad" }', signal="obs_2")
    assert [each.name for each in some.spec.columns] == ["t", "obs_2", "ended"]
    with pytest.raises(DefinitionError, match=r"system\.columns: 'angle' is none of obs_0, .*all 4 numbers"):
        environment("CartPole-v1", "length = [0.4, 0.6]", 'columns = { angle = "rad" }', signal="angle")


def test_parameters_are_attributes_keys_of_the_config_and_options(environment: Make) -> None:
    space = "width = { low = 1, high = 5, step = 1 }\nspeed = [0.1, 2]\nfrom = [-1, 1]"
    system = environment("walk:Walk-v0", space, policy=WALKS)
    found = rolled(system, 4.0, 2.0, -0.5, horizon=1.0)
    assert found.columns == ("t", "own_place_0", "own_place_1", "lane_0", "reward", "clock", "far", "ended")
    assert found.column("own_place_1").tolist() == [4.0] * 5, "also at 0, whatever ran before"
    assert np.allclose(np.diff(found.column("own_place_0")), 2.0)
    assert np.allclose(rolled(system, 4.0, 2.0, 0.5).samples[:5, 1] - found.samples[:, 1], 1.0)
    assert found.column("clock").tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert found.column("far").tolist() == [1.0, 1.0, 1.0, 1.0, 1.0], "at 0 as after the first step, which has it"
    assert found.column("ended").tolist() == [0.0, 0.0, 0.0, 1.0, 1.0], "stepped on beyond the end"
    assert set(system.spec.code) == {"policy.py", "walk.py"}


def test_options_of_the_system_are_arguments_of_the_environment(environment: Make) -> None:
    system = environment("walk:Walk-v0", "speed = [0.1, 2]", "slope = -1", policy=WALKS)
    assert np.allclose(np.diff(rolled(system, 0.5).column("own_place_0")), -0.5)
    given: Any = {"variant": "nominal", "seed": 7, "horizon": 2.0, "progress": lambda _: None}
    with pytest.raises(SimulationError, match=r"slope is a number in \[-1\.0, -1\.0\], not 2\.0"):
        system.rollout((0.5,), options={"slope": 2.0}, **given)
    with pytest.raises(DefinitionError, match=r"system\.gymnasium: walk:Walk-v0: .*unexpected keyword argument"):
        environment("walk:Walk-v0", "speed = [0.1, 2]", "slope = 1\nslop = 2", policy=WALKS)


@pytest.mark.parametrize("after_end", ["hold", "fail"])
def test_an_end_may_be_the_last_sample(environment: Make, after_end: str) -> None:
    system = environment("walk:Walk-v0", "speed = [0.1, 2]", f"after_end = {after_end!r}", policy=WALKS)
    assert system.spec.after_end == after_end
    found = rolled(system, 0.5)
    assert found.columns[-1] == "far"
    assert found.column("t").tolist() == [0.0, 0.25, 0.5, 0.75]


def test_an_environment_that_cannot_be_stepped_on_says_what_to_write(environment: Make) -> None:
    system = environment("walk:Walk-v0", "speed = [0.1, 2]", policy=WALKS, breaks=3)
    assert len(rolled(system, 0.5, horizon=0.75).samples) == 4
    with pytest.raises(SimulationError, match=r'it is over.*after_end = "hold" or "fail"'):
        rolled(system, 0.5)


def test_a_reset_beside_the_policy_starts_the_episode(environment: Make) -> None:
    policy = f"""{ACTS}
def reset(env, *, seed, angle):
    _, info = env.reset(seed=seed)
    env.unwrapped.state = (0.0, 0.0, angle, 0.0)
    return env.unwrapped.state, info
"""
    found = rolled(environment("CartPole-v1", "angle = [-0.1, 0.1]", policy=policy), 0.05)
    assert found.samples[0, 1:5].tolist() == [0.0, 0.0, 0.05, 0.0]
    wrong = policy.replace("return env.unwrapped.state, info", "return env.unwrapped.state")
    with pytest.raises(DefinitionError, match=r"reset returns tuple, not observation and info"):
        environment("CartPole-v1", "angle = [-0.1, 0.1]", policy=wrong)


def test_a_policy_with_a_memory_is_reset_before_each_rollout(environment: Make) -> None:
    policy = """
class Act:
    def __init__(self):
        self.calls = 0
    def reset(self):
        self.calls = 0
    def __call__(self, observation):
        self.calls += 1
        return self.calls % 3 == 0
"""
    system = environment("CartPole-v1", "length = [0.4, 0.6]", policy=policy.replace("Act", "act"))
    assert np.array_equal(rolled(system, 0.5, horizon=0.2).samples, rolled(system, 0.5, horizon=0.2).samples)


@pytest.mark.parametrize(
    ("named", "space", "keys", "said"),
    [
        ("CartPole-v9", "length = [0.4, 0.6]", "", r"system\.gymnasium: CartPole-v9: .*CartPole"),
        ("CartPole-v1", "length = [0.4, 0.6]", 'colums = "x"', r"system\.gymnasium: did you mean 'columns'\?"),
        ("CartPole-v1", "length = [0.4, 0.6]", "clip = 3", r"gymnasium: put the key `clip` of the campaign above the"),
        ("absent:Own-v0", "length = [0.4, 0.6]", "", r"system\.gymnasium: absent:Own-v0: .*absent"),
        ("CartPole-v1", "lenght = [0.4, 0.6]", "", r"no attribute lenght, and .*write a function reset\(env, \*, seed"),
        ("CartPole-v1", "lenght = [0.4, 0.6]", "", r"space: did you mean 'length'\?"),
        ("walk:Walk-v0", "title = [0, 1]", "", r"space: title is an attribute of the environment, and str and no num"),
        ("walk:Walk-v0", "width = [1, 5]", "", r"write width = \{ low = 1, high = 5, step = 1 \}"),
        (
            "CartPole-v1",
            "length = [0.4, 0.6]",
            "step = 0.05",
            r"says itself that a step lasts 0.02 s \(tau\), not 0.05",
        ),
        ("MountainCar-v0", "force = [0.001, 0.002]", "", r"system\.step: MountainCar-v0 does not say how long a step"),
        ("CartPole-v1", "length = [0.4, 0.6]", 'files = ["no.csv"]', "there is no 'no.csv'"),
    ],
)
def test_what_cannot_be_is_refused_with_the_remedy(
    environment: Make, named: str, space: str, keys: str, said: str
) -> None:
    with pytest.raises(DefinitionError, match=said):
        environment(named, space, keys, policy=ACTS)


def test_an_action_that_a_reset_draws_follows_from_the_seed(environment: Make) -> None:
    """Some environments draw one from their action space, which no `reset(seed=seed)` reaches."""
    policy = f"""{ACTS}
def reset(env, *, seed, length):
    found = env.reset(seed=seed)
    env.unwrapped.length = length + sum(2.0**-k * env.action_space.sample() for k in range(1, 25))
    return found
"""
    system = environment("CartPole-v1", "length = [0.4, 0.6]", policy=policy)
    first, again, other = (rolled(system, 0.5, seed=seed, horizon=0.4).samples for seed in (7, 7, 8))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_reset_that_lacks_a_parameter_is_refused_with_all_of_them(environment: Make) -> None:
    policy = f"{ACTS}\ndef reset(env, *, seed, length):\n    return env.reset(seed=seed)\n"
    with pytest.raises(DefinitionError, match=r"every parameter, reset\(env, \*, seed, length, angle\): got an unex"):
        environment("CartPole-v1", "length = [0.4, 0.6]\nangle = [0, 0.1]", policy=policy)


@pytest.mark.parametrize(
    ("named", "space", "action", "said"),
    [
        ("CartPole-v1", "length = [0.4, 0.6]", "2", r"policy\.py returned 2, and an action is one of Discrete\(2\)"),
        ("CartPole-v1", "length = [0.4, 0.6]", "'left'", r"returned 'left', and an action is one of"),
        ("CartPole-v1", "length = [0.4, 0.6]", "0.0", r"returned 0\.0, and"),
        ("Pendulum-v1", "g = [9, 11]", "[0.0, 0.0, 0.0]", r"an action is one of Box\(-2\.0, 2\.0, \(1,\), float32\)"),
        ("Pendulum-v1", "g = [9, 11]", "[float('nan')]", r"returned \[nan\], and an action is one of"),
        ("Pendulum-v1", "g = [9, 11]", "0.5", r"\(1,\), float32\); return an array of the shape \(1,\)"),
        ("Pendulum-v1", "g = [9, 11]", "['x']", r"returned \['x'\], and an action is one of"),
    ],
)
def test_what_is_no_action_is_refused(environment: Make, named: str, space: str, action: str, said: str) -> None:
    with pytest.raises(DefinitionError, match=rf"system\.policy: .*{said}"):
        environment(named, space, policy=f"def act(observation):\n    return {action}\n")


def test_an_action_beyond_its_limits_is_left_to_the_environment(environment: Make) -> None:
    system = environment("Pendulum-v1", "g = [9, 11]", policy="def act(observation):\n    return [5.0]\n")
    assert len(rolled(system, 10.0, horizon=0.5).samples) == 11


def test_a_horizon_of_less_than_a_step_is_refused(environment: Make) -> None:
    with pytest.raises(SimulationError, match=r"a horizon of 0\.01 s is less than a step of cartpole-v1, 0\.02 s"):
        rolled(environment("CartPole-v1", "length = [0.4, 0.6]"), 0.5, horizon=0.01)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('policy = "policy.py:act"\n', "", r"system\.policy: required by an environment of Gymnasium"),
        ('policy = "policy.py:act"', 'policy = "policy.py"', r"system\.policy: 'policy.py' is not allowed"),
        ("policy.py:act", "none.py:act", r"none\.py: there is no such Python file"),
        ("policy.py:act", "policy.py:acts", r"there is no function 'acts' in it"),
        ("policy.py:act", "model.zip:PPO", r"model\.zip: there is no such model"),
        ("KEYS", 'samples = "npy"', r"system\.samples: this key is for a program alone"),
        (
            'gymnasium = "ID"',
            'gymnasium = "ID"\npython = "a.py:b"',
            r"system\.name: python and gymnasium .*; give one of name",
        ),
    ],
)
def test_a_wrong_table_names_the_key(tmp_path: Path, old: str, new: str, said: str) -> None:
    (tmp_path / "policy.py").write_text(ACTS)
    text = CAMPAIGN.replace(old, new).replace("KEYS", "").replace("SPACE", "length = [0.4, 0.6]")
    with pytest.raises((CampaignError, DefinitionError), match=said):
        load_environment(
            tmp_path / "c.toml",
            parse_campaign(text.replace("ID", "CartPole-v1").replace("SIGNAL", "reward").encode(), "c.toml"),
        )


def test_a_model_needs_its_library(tmp_path: Path) -> None:
    (tmp_path / "model.zip").write_bytes(b"")
    with pytest.raises(DefinitionError, match="no algorithm 'PPO' of stable_baselines3 or sb3_contrib is installed"):
        load_policy("model.zip:PPO", tmp_path)


def test_a_model_acts_by_what_its_library_predicts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A library of the same names: that of Stable-Baselines3 needs torch."""
    (tmp_path / "model.zip").write_bytes(b"weights")

    class PPO:
        @classmethod
        def load(cls, path: Path, device: str) -> "PPO":
            assert (path.read_bytes(), device) == (b"weights", "cpu")
            return cls()

        def predict(self, observation: float, *, deterministic: bool) -> tuple[float, None]:
            assert deterministic
            return 2 * observation, None

    threads: list[int] = []
    monkeypatch.setitem(sys.modules, "stable_baselines3", SimpleNamespace(PPO=PPO))
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(set_num_threads=threads.append))
    versions = "perfbound.workers.systems.policy.versions_of"
    monkeypatch.setattr(versions, lambda _, modules: {name: f"1 of {name}" for name in modules})
    found = load_policy("model.zip:PPO", tmp_path)
    assert (found.act(3.0), threads) == (6.0, [1])
    assert found.digests == {"model.zip": hashlib.sha256(b"weights").hexdigest()}
    assert found.versions == {"stable_baselines3": "1 of stable_baselines3", "torch": "1 of torch"}


def test_a_model_of_another_algorithm_is_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "model.zip").write_bytes(b"weights")

    class SAC:
        @classmethod
        def load(cls, path: Path, device: str) -> None:
            raise AttributeError("'ActorCriticPolicy' object has no attribute 'actor'")

    monkeypatch.setitem(sys.modules, "stable_baselines3", SimpleNamespace(SAC=SAC))
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(set_num_threads=lambda _: None))
    with pytest.raises(DefinitionError, match=r"model.zip: it cannot be loaded as a model of SAC .*name the algorithm"):
        load_policy("model.zip:SAC", tmp_path)


def test_an_action_beyond_the_limits_is_reported_to_the_check(environment: Make) -> None:
    acts = "import numpy as np\ndef act(observation):\n    return np.array([FORCE], dtype=np.float32)\n"
    wild = environment("Pendulum-v1", "g = [9, 10]", policy=acts.replace("FORCE", "17"))
    rolled(wild, 9.5)
    found = wild.acted()
    assert found is not None
    assert "policy.py returned array([17.], dtype=float32), outside Box(-2.0, 2.0, (1,), float32)" in found.outside
    # Not beyond those in float32, and what one rollout did is not said of the next one.
    limits = acts.replace("dtype=np.float32", "").replace("FORCE", "2 * (observation[0] < 9) ")
    calm = environment("Pendulum-v1", "g = [9, 10]", policy=limits)
    rolled(calm, 9.5)
    assert calm.acted() == Acts()
    discrete = environment("CartPole-v1", "length = [0.4, 0.6]")
    rolled(discrete, 0.5, horizon=0.2)
    assert discrete.acted() == Acts()


def test_a_package_that_is_not_installed_is_named_with_the_command(
    environment: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(DefinitionError, match=r"gymnasium is not installed; pip install 'perfbound\[gymnasium\]'$"):
        environment("CartPole-v1", "length = [0.4, 0.6]")
