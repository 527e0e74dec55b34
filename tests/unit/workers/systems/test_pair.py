"""Two simulators as one system: what each contributes, and what does not fit."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.schemas.errors import CampaignError, DefinitionError, SimulationError, UnknownSystemError
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.requests import RequestTemplate
from perfbound.workers import systems
from perfbound.workers.simulate import requested_system
from perfbound.workers.systems.files import load_reference
from perfbound.workers.systems.pair import TwoSimulators

MODEL = """
import perfbound as pb
@pb.system(parameters={"a": pb.Parameter(0, 5, unit="m")}, columns={"y": "m", "z": ""}, step=0.5)
def model(a, *, slope=2.0, horizon=1.0):
    return [a, a + slope], [0.0, 9.0]
"""
PLANT = """
import perfbound as pb
@pb.system(parameters={"a": pb.Parameter(1, 9, unit="m")}, columns={"w": "", "y": "m"}, step=0.25,
           disturbances={"gust": pb.Normal(0, 1)})
def plant(a, *, gust, variant, horizon=1.0):
    return [5.0] * 4, [a + gust, a, a, a + 3.0 * (variant == "true")]
"""
CAMPAIGN = """
horizon = 1
specification = "always (y >= 0)"
falsify = {}
max_tests = 5
[system]
columns = { y = "m" }
nominal = { python = "model.py:model", slope = 1.5 }
true = { python = "plant.py:plant" }
[space]
a = [2, 3]
"""
Make = Callable[..., TwoSimulators]


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    def make(campaign: str = CAMPAIGN, **files: str) -> TwoSimulators:
        for name, text in {"model": MODEL, "plant": PLANT, **files}.items():
            if text:
                (tmp_path / f"{name}.py").write_text(text)
        (tmp_path / "c.toml").write_text(campaign)
        found = load_reference(str(tmp_path / "c.toml"))
        assert isinstance(found, TwoSimulators)
        monkeypatch.setitem(systems._FROM_FILES, found.name, found)
        return found

    return make


def requested(template: RequestTemplate, variant: Any) -> Any:
    return template.request(RolloutId("robustness", 1, variant, 0), (2.5,), 7)


def test_each_variant_is_that_of_its_simulator(pair: Make) -> None:
    both = pair()
    spec = both.spec
    assert (spec.name, spec.variants, spec.noisy) == ("model-and-plant", ("nominal", "true"), ("true",))
    assert [(each.name, each.low, each.high, each.unit) for each in spec.parameters] == [("a", 1.0, 5.0, "m")]
    assert [(each.name, each.unit) for each in spec.columns] == [("t", "s"), ("y", "m")]
    assert [each.name for each in spec.disturbances] == ["gust"]
    assert set(spec.code) == {"model.py", "plant.py"}
    assert spec.simulators.keys() == {"nominal", "true"}
    assert not spec.residual
    keys: dict[str, Any] = {"seed": 7, "horizon": 1.0, "options": {}, "progress": lambda _: None}
    nominal = both.rollout((2.5,), variant="nominal", disturbances={"gust": 0.25}, **keys)
    true = both.rollout((2.5,), variant="true", disturbances={"gust": 0.25}, **keys)
    assert nominal.samples.tolist() == [[0.0, 2.5], [0.5, 4.0]]
    assert true.samples.tolist() == [[0.0, 2.75], [0.25, 2.5], [0.5, 2.5], [0.75, 5.5]]


def test_a_request_names_the_simulator_of_its_variant(pair: Make) -> None:
    both = pair()
    template = RequestTemplate.of(both.spec, {}, horizon=1.0, visual=False)
    nominal, true = requested(template, "nominal"), requested(template, "true")
    assert nominal.spec_sha256 == both.half("nominal").spec.digest == both.spec.simulators["nominal"]
    assert true.spec_sha256 == both.half("true").spec.digest
    assert (nominal.disturbances, len(true.disturbances)) == ((), 1)
    assert requested_system(true) is both.half("true")
    with pytest.raises(SimulationError, match="another build"):
        requested_system(true.model_copy(update={"spec_sha256": nominal.spec_sha256}))


def test_a_worker_with_one_of_them_announces_it(pair: Make) -> None:
    whole = pair().spec
    both = pair(plant="raise ValueError('no licence')")
    announced = systems.announced()
    name = both.name
    assert f"{name}/true" not in announced
    assert name not in announced
    assert announced[f"{name}/nominal"].digest == whole.simulators["nominal"]
    with pytest.raises(UnknownSystemError, match=r"true: .*plant\.py, line 1: ValueError: no licence"):
        _ = both.spec
    assert both.half("nominal").rollout(
        (2.5,), variant="nominal", seed=7, horizon=1.0, options={}, progress=lambda _: None
    ).samples.tolist() == [[0.0, 2.5], [0.5, 4.0]]


@pytest.mark.parametrize(
    ("step", "words"), [("0.4", "steps of 0.4 s the last one before 1 s ends at 0.8 s"), ("2", "less than one step")]
)
def test_a_step_that_does_not_cover_the_horizon_is_refused_with_its_variant(pair: Make, step: str, words: str) -> None:
    both = pair(plant=PLANT.replace("step=0.25", f"step={step}"))
    with pytest.raises(UnknownSystemError, match=f"^true: horizon: .*{words}"):
        _ = both.spec


def test_an_option_and_a_file_are_part_of_the_identity(pair: Make) -> None:
    before = pair().spec
    other = pair(CAMPAIGN.replace("slope = 1.5", "slope = 1.6")).spec
    assert other.simulators["nominal"] != before.simulators["nominal"]
    assert other.simulators["true"] == before.simulators["true"]
    changed = pair(plant=PLANT + "\n").spec
    assert changed.simulators["true"] != before.simulators["true"]
    assert changed.digest != before.digest


def test_two_vectorised_ones_are_vectorised(pair: Make) -> None:
    many = MODEL.replace("step=0.5", "step=0.5, vectorised=True").replace(
        "[a, a + slope], [0.0, 9.0]",
        "__import__('numpy').stack([a[:, None] + [0, slope], a[:, None] * [0, 9]], axis=2)",
    )
    both = pair(
        CAMPAIGN.replace("plant.py:plant", "plant.py:model"), model=many, plant=many.replace("a + slope", "a + slope")
    )
    assert both.spec.vectorised
    keys: dict[str, Any] = {"horizon": 1.0, "options": {}, "progress": lambda _: None}
    seeds = np.zeros(2, dtype=np.uint64)
    found: Any = both.rollouts(np.array([[2.0], [3.0]]), variant="nominal", seeds=seeds, **keys)
    assert found.tolist() == [[[0.0, 2.0], [0.5, 3.5]], [[0.0, 3.0], [0.5, 4.5]]]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"plant": PLANT.replace('unit="m"', 'unit="cm"', 1)}, r"nominal are a \(m\), those of true a \(cm\)"),
        ({"plant": PLANT.replace("Parameter(1, 9", "Parameter(6, 9")}, "a: the ranges .* have no value in common"),
        ({"plant": PLANT.replace("step=0.25", "step=0.25, after_end='hold'")}, "after_end: is None in nominal"),
        (
            {
                "model": MODEL.replace("step=0.5", "step=0.5, disturbances={'b': pb.Normal(0, 2)}").replace(
                    "*,", "*, b,"
                )
            },
            "disturbances: those of nominal and true differ",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(pair: Make, files: dict[str, str], message: str) -> None:
    with pytest.raises(DefinitionError, match=message):
        _ = pair(**files).spec


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('{ y = "m" }', '{ z = "" }', "columns: 'z' is no column of true: t, w, y"),
        ('{ y = "m" }', '{ y = "cm" }', "columns: y is in 'm' in nominal, and not in 'cm'"),
        ("slope = 1.5", "slpe = 1.5", "nominal.slpe: model has no such option"),
        ("model.py:model", "none.py:model", None),
    ],
)
def test_what_the_file_says_wrongly_is_refused(pair: Make, old: str, new: str, message: str | None) -> None:
    if message is not None:
        with pytest.raises(DefinitionError, match=rf"c\.toml: system\.{message}"):
            pair(CAMPAIGN.replace(old, new))
    else:
        with pytest.raises(DefinitionError, match=r"none\.py: there is no such .*none\.py: there is no such"):
            pair(CAMPAIGN.replace(old, new).replace("plant.py:plant", "none.py:plant"))


@pytest.mark.parametrize(
    ("system", "message"),
    [
        ('nominal = { name = "a" }', "true: required by two simulators"),
        ('nominal = { name = "a" }\ntrue = { name = "b" }', "columns: required by two simulators"),
        ('columns = { y = "" }\nnominal = { name = "a" }\ntrue = { name = "b" }\ngain = 2', "gain: an option belongs"),
        ('true = { name = "b" }\nname = "a"', "true: this key is for two simulators alone"),
        (
            'columns = { y = "" }\nnominal = { name = "a" }\n'
            'true = { columns = { y = "" }, nominal = { name = "a" }, true = { name = "b" } }',
            "true: is itself two simulators",
        ),
    ],
)
def test_tables_that_are_no_pair_are_refused(system: str, message: str) -> None:
    start, rest = CAMPAIGN.partition("[system]")[0], CAMPAIGN.partition("[space]")[2]
    with pytest.raises(CampaignError, match=message):
        parse_campaign(f"{start}[system]\n{system}\n[space]{rest}".encode(), "c.toml")
