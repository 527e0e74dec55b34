"""Systems of one function: what follows from the signature, what may be returned, and what is refused."""

import io
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from mcap.reader import make_reader

import perfbound as pb
from perfbound.schemas.errors import DefinitionError, SimulationError, UnknownSystemError
from perfbound.schemas.file.signals import SignalShape
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.requests import RequestTemplate
from perfbound.schemas.system import ASSUMED_HORIZON
from perfbound.schemas.trajectory.trajectory import read_canonical, read_mcap
from perfbound.workers import simulate, systems
from perfbound.workers.simulate import drawn, run_request_on
from perfbound.workers.systems.decorator import system
from perfbound.workers.systems.elsewhere import MODULE
from perfbound.workers.systems.files import load_file
from perfbound.workers.systems.function import FunctionSystem
from tests.facts import facts

RANGE = {"x": pb.Parameter(0, 1, unit="m")}
T = np.arange(5.0)


def made(function: Callable[..., Any], **changes: Any) -> FunctionSystem:
    return system(**{"parameters": RANGE, "columns": {"a": "m", "b": ""}, "name": "f", **changes})(function)


def rolled(function: Callable[..., Any], *, options: dict[str, Any] | None = None, **changes: Any) -> Any:
    found = made(function, **changes)
    return found.rollout((0.5,), variant="nominal", seed=7, horizon=2.0, options=options or {}, progress=lambda _: None)


# The specification


def test_the_spec_follows_from_the_signature() -> None:
    @pb.system(parameters={"gap": pb.Parameter(5, 60, unit="m"), "v": pb.Parameter(0, 9)}, columns={"d": "m"}, step=0.1)
    def my_cars(gap: float, v: float, *, seed: int, mode: Literal["a", "b"] = "b", reaction: float = 0.4) -> float:
        """Two cars.

        More about them.
        """
        return gap - v * reaction

    spec = my_cars.spec
    assert (spec.name, spec.doc, spec.variants, spec.noisy) == ("my-cars", "Two cars.", ("nominal",), ("nominal",))
    assert [(each.name, each.low, each.high, each.unit) for each in spec.parameters] == [
        ("gap", 5, 60, "m"),
        ("v", 0, 9, ""),
    ]
    assert [(each.name, each.unit) for each in spec.columns] == [("t", "s"), ("d", "m")]
    assert [(each.name, each.default, each.choices) for each in spec.options] == [
        ("mode", "b", ("a", "b")),
        ("reaction", 0.4, ()),
    ]
    assert my_cars(10.0, 5.0, seed=0) == 8.0, "it can still be called"


def whole(found: FunctionSystem, x: float = 0.5) -> Any:
    """Return the trajectory of a rollout of 2 s, as a worker sends it."""
    template = RequestTemplate.of(found.spec, {}, horizon=2.0, visual=True)
    request = template.request(RolloutId("robustness", 0, "nominal", 0), (x,), 7)
    return read_mcap(run_request_on(found, request, lambda _: None)).trajectory


def short(x: float, *, horizon: float) -> np.ndarray[Any, Any]:
    return np.full((round(horizon * x / 0.1) + 1, 2), x)


@pytest.mark.integration
def test_an_early_end_is_held_where_the_system_declares_it() -> None:
    found = whole(made(short, step=0.1, after_end="hold"))
    assert found.columns == ("t", "a", "b", "ended")
    assert found.column("t").tobytes() == (np.arange(21) * 0.1).tobytes()
    assert found.column("ended").tolist() == [0.0] * 11 + [1.0] * 10
    assert set(found.column("a")) == {0.5}
    assert not whole(made(short, step=0.1, after_end="fail"), 1.0).column("ended").any()
    assert whole(made(short, step=0.1)).columns == ("t", "a", "b")
    with pytest.raises(DefinitionError, match=facts("columns: ended column after_end")):
        made(short, columns={"a": "m", "ended": ""}, after_end="hold")
    assert made(short, columns={"a": "m", "ended": ""}).spec.after_end is None


def test_a_spec_by_hand_has_the_column_of_the_end() -> None:
    with pytest.raises(DefinitionError, match="with after_end the last one is ended"):
        pb.SystemSpec(
            name="a",
            doc="",
            parameters=(pb.Parameter(0, 1, name="x"),),
            columns=(pb.Column(name="t", unit="s"), pb.Column(name="y", unit="m")),
            max_horizon=1,
            after_end="hold",
        )


OVER_TIME = {"u": pb.Parameter(0, 1, signal=True), "x": pb.Parameter(0, 9)}


def test_an_input_over_time_is_a_function_of_it() -> None:
    def ramp(u: pb.InputSignal, x: float, *, horizon: float) -> dict[str, Any]:
        t = np.linspace(0.0, horizon, 5)
        return {"t": t, "a": u(t) * x, "b": [u(each) for each in t.tolist()]}

    found = made(ramp, parameters=OVER_TIME)
    assert found.spec.versions.keys() == {"numpy", "scipy"}, "they interpolate, so they decide the trajectory"
    template = RequestTemplate.of(
        found.spec.spread([SignalShape(name="u", kind="linear", knots=2)]), {}, horizon=2.0, visual=False
    )
    request = template.request(RolloutId("robustness", 0, "nominal", 0), (0.0, 1.0, 4.0), 7)
    columns = read_mcap(run_request_on(found, request, lambda _: None)).trajectory
    assert columns.column("a").tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert columns.column("b").tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_a_recorded_input_is_a_column_behind_those_of_the_system() -> None:
    def early(u: pb.InputSignal, x: float, *, horizon: float) -> dict[str, Any]:
        t = np.linspace(0.0, horizon, 5)[:3]
        return {"t": t, "a": u(t), "b": u(t) * x}

    found = made(early, parameters=OVER_TIME, after_end="hold")
    shape = SignalShape(
        name="u", kind="sine", knots=0, parts={"amplitude": (0.0, 0.5), "frequency": 0.5, "offset": 0.5}
    )
    shape = shape.model_copy(update={"recorded": True, "parts": {**shape.parts, "phase": 0.0}})
    template = RequestTemplate.of(found.spec.spread([shape]), {}, horizon=2.0, visual=False)
    request = template.request(RolloutId("robustness", 0, "nominal", 0), (0.5, 4.0), 7)
    trajectory = read_mcap(run_request_on(found, request, lambda _: None)).trajectory
    assert trajectory.columns == ("t", "a", "b", "u", "ended") == tuple(c.name for c in template.spec.columns)
    # The state is held from 1 s on, and the input continues.
    assert trajectory.column("u").tolist() == pytest.approx([0.5, 1.0, 0.5, 0.0, 0.5])
    assert trajectory.column("a").tolist() == pytest.approx([0.5, 1.0, 0.5, 0.5, 0.5])


@pytest.mark.parametrize(
    ("x", "reason"),
    [
        ((0.5, 3.0), "u is an input over time, not float"),
        ((pb.InputSignal("linear", (0.0, 2.0), 1.0), 3.0), r"u = 2\.0 is outside \[0\.0, 1\.0\]"),
        ((pb.InputSignal("linear", (0.0, 1.0), 1.0),) * 2, "x is a number, not InputSignal"),
    ],
)
def test_an_input_over_time_is_checked(x: tuple[Any, ...], reason: str) -> None:
    found = made(lambda u, x: (0.0, 0.0), parameters=OVER_TIME)
    with pytest.raises(SimulationError, match=reason):
        found.rollout(x, variant="nominal", seed=7, horizon=2.0, options={}, progress=lambda _: None)


def test_without_seed_nothing_is_noisy_and_with_variant_there_are_two() -> None:
    assert made(lambda x: (x, x)).spec.noisy == ()
    both = made(lambda x, *, variant, seed: (x, x)).spec
    assert both.variants == both.noisy == ("nominal", "true")
    assert made(lambda x, *, variant, seed: (x, x), noisy=["true"]).spec.noisy == ("true",)


def test_the_default_horizon_is_that_of_the_function_and_no_part_of_its_identity() -> None:
    own = made(lambda x, *, horizon=8: (x, x)).spec
    named = made(lambda x, *, horizon: (x, x)).spec
    assert (own.default_horizon, own.assumed_horizon, own.timed) == (8.0, 8.0, True)
    assert (named.default_horizon, named.assumed_horizon, named.timed) == (None, ASSUMED_HORIZON, True)
    assert own.digest == named.digest, "every request has its own horizon"
    assert made(lambda x: (x, x)).spec.assumed_horizon == 0.0, "one sample"
    assert made(lambda x, *, horizon: (x, x), max_horizon=3.0).spec.assumed_horizon == 3.0


def test_short_seeds_are_part_of_the_spec_and_of_its_digest() -> None:
    plain, short = made(lambda x, *, seed: (x, x)).spec, made(lambda x, *, seed: (x, x), seed_bits=32).spec
    assert (plain.seed_bits, short.seed_bits) == (53, 32)
    assert plain.digest != short.digest
    # What has 53 bits is the system that it was before there was this key.
    assert "seed_bits" not in plain.model_dump(mode="json", exclude_defaults=True)
    with pytest.raises(DefinitionError, match=facts("seed_bits: 16: greater equal 31")):
        made(lambda x, *, seed: (x, x), seed_bits=16)


@pytest.mark.parametrize(
    ("function", "changes", "words"),
    [
        (lambda x, *, horizon=None: x, {}, "horizon: None (0, 3600]"),
        (lambda x, *, horizon=0: x, {}, "horizon: 0 seconds"),
        (lambda x, *, horizon=9.0: x, {"max_horizon": 8.0}, "horizon: 9.0 (0, 8]"),
        (lambda y: y, {}, "positional y `parameters` x"),
        (lambda x, y: y, {}, "positional x, y `parameters` x"),
        (lambda *x: x, {}, "*x names"),
        (lambda x, *, gain: x, {}, "'gain' perfbound seed horizon variant progress"),
        (lambda x, *, name="a": x, {}, "'name' [system]"),
        (lambda x, *, on=True: x, {}, "'on' number word True"),
        (lambda x: x, {"noisy": ["nominal"]}, "`seed`"),
        (lambda x, *, seed: x, {"noisy": ["true"]}, "'true' only nominal"),
        (lambda x: x, {"step": 0.0}, "step: 0.0 positive"),
        (lambda x: x, {"columns": {"Distance": "m"}}, "'Distance': a-z 0-9 _"),
        (lambda x: x, {"columns": ["y"]}, "columns 'height': 'm'"),
        (lambda x: x, {"parameters": {"x": (0.0, 1.0)}}, "x: (0.0, 1.0) pb.Parameter(low, high)"),
    ],
)
def test_a_signature_that_does_not_fit_is_refused(
    function: Callable[..., Any], changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(DefinitionError, match=facts(words)):
        made(function, **changes)


# What is returned


@pytest.mark.parametrize(
    ("returned", "step"),
    [
        ((T, -T), 1.0),
        ([T, -T], 1.0),
        (np.column_stack([T, -T]), 1.0),
        ({"a": T, "b": -T}, 1.0),
        ({"b": -T, "a": T, "t": T}, None),
    ],
)
def test_columns_may_be_a_tuple_an_array_or_a_dict(returned: Any, step: float | None) -> None:
    found = rolled(lambda x: returned, step=step)
    assert found.columns == ("t", "a", "b")
    assert found.samples.tolist() == np.column_stack([T, T, -T]).tolist()


@pytest.mark.parametrize("returned", [(1, 2.0), {"a": [1], "b": 2}, np.array([1.0, 2.0]), np.array([[1.0, 2.0]])])
def test_numbers_are_one_sample_at_time_zero(returned: Any) -> None:
    assert rolled(lambda x: returned).samples.tolist() == [[0.0, 1.0, 2.0]]


def test_one_column_needs_no_tuple() -> None:
    assert rolled(lambda x: x, columns={"a": "m"}).samples.tolist() == [[0.0, 0.5]]
    assert rolled(lambda x: T, columns={"a": "m"}, step=0.5).samples[:, 0].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]


@pytest.mark.parametrize(
    ("returned", "words"),
    [
        ((T, T, T), "3 values columns a, b"),
        ({"a": T}, "returned a columns a, b"),
        ((T, T[:3]), "length a 5 b 3"),
        ((T, T), "5 samples 't' `step`"),
        (np.zeros((5, 3)), "(5, 3) columns a, b"),
        ((T, "far"), "b text"),
        (None, "None"),
        ((np.zeros((5, 2)), T), "a (5, 2)"),
        (([], []), "least one sample"),
        ((math.nan, 1.0), "not finite"),
        ({"a": T, "b": T, "t": T[::-1]}, "not decrease"),
    ],
)
def test_what_is_no_trajectory_is_refused_with_its_remedy(returned: Any, words: str) -> None:
    with pytest.raises(SimulationError, match=facts(words)):
        rolled(lambda x: returned)


def test_options_keep_their_kind() -> None:
    def counted(x: float, *, count: int = 3, gain: float = 1) -> tuple[list[float], list[float]]:
        return [float(x)] * count, [gain] * count

    assert len(rolled(counted, step=1.0, options={"count": 4.0}).samples) == 4
    with pytest.raises(SimulationError, match=r"option count is a whole number, not 2\.5"):
        rolled(counted, step=1.0, options={"count": 2.5})


def test_the_file_of_a_function_plots_its_columns_unless_that_is_switched_off() -> None:
    found = made(lambda x: (x * T, T), step=0.5)
    template = RequestTemplate.of(found.spec, {}, horizon=0.0, visual=True)
    request = template.request(RolloutId("simulate", 0, "nominal", 0), (0.5,), 0)
    topics = {
        visual: {channel.topic for _, channel, _ in make_reader(io.BytesIO(data)).iter_messages()}
        for visual in (True, False)
        for data in [run_request_on(found, request.model_copy(update={"visual": visual}), lambda _: None)]
    }
    assert topics == {True: {"/a", "/b"}, False: set()}


@pytest.mark.parametrize("after_end", [None, "hold"])
def test_a_recorded_file_is_drawn_as_its_rollout_would_be(after_end: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    found = made(lambda x: (x * T, T), step=0.5, after_end=after_end)
    template = RequestTemplate.of(found.spec, {}, horizon=3.0 if after_end else 0.0, visual=False)
    request = template.request(RolloutId("simulate", 0, "nominal", 0), (0.5,), 0)
    plain = run_request_on(found, request, lambda _: None)
    monkeypatch.setattr(simulate, "load_system", lambda _: found)
    wanted = run_request_on(found, request.model_copy(update={"visual": True}), lambda _: None)
    assert drawn(read_canonical(plain, visual=False)) == wanted


def test_a_class_is_made_once() -> None:
    made_at: list[int] = []

    class Loaded:
        """What is costly stays."""

        def __init__(self) -> None:
            made_at.append(1)

        def __call__(self, x: float, *, seed: int) -> tuple[float, float]:
            return x, seed

    found = made(Loaded)
    assert made_at == [], "the spec needs no instance"
    for seed in (1, 2):
        trajectory = found.rollout(
            (0.5,), variant="nominal", seed=seed, horizon=0.0, options={}, progress=lambda _: None
        )
        assert trajectory.samples.tolist() == [[0.0, 0.5, seed]]
    assert made_at == [1]


@pytest.mark.integration
def test_a_function_without_progress_shows_that_it_lives(monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    monkeypatch.setattr("perfbound.workers.systems.life.TICK", 0.01)
    steps: list[int] = []

    def slow(x: float) -> tuple[float, float]:
        while len(steps) < 3:
            time.sleep(0.01)
        return x, x

    made(slow).rollout((0.5,), variant="nominal", seed=0, horizon=0.0, options={}, progress=steps.append)
    assert steps[:3] == [1, 2, 3]


# Files


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(systems, "_FROM_FILES", {})
    known = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - known | {MODULE}:
        sys.modules.pop(name, None)


CARS = """import perfbound as pb
{more}
@pb.system(parameters={{"x": pb.Parameter(0, 1)}}, columns={{"a": "m"}})
def cars(x):
    return x
"""


def written(folder: Path, text: str = CARS.format(more="")) -> str:
    (folder / "cars.py").write_text(text)
    return f"{folder / 'cars.py'}:cars"


def test_a_file_is_a_system_with_its_code(folder: Path) -> None:
    (folder / "perfbound_helper.py").write_text("GAIN = 2")
    spec = load_file(written(folder, CARS.format(more="import perfbound_helper"))).spec
    assert sorted(spec.code) == ["cars.py", "perfbound_helper.py"]
    assert systems.add_file(written(folder)) == "cars"
    assert systems.load_system("cars").spec.code.keys() == {"cars.py"}
    assert "cars" in systems.available()


@pytest.mark.rest
def test_two_systems_of_a_folder_share_a_module_and_no_package(folder: Path) -> None:
    """Each names it; a package in an environment beside the file is not its code."""
    (folder / "shared_helper.py").write_text("GAIN = 2")
    package = folder / ".venv" / "lib" / "site-packages"
    package.mkdir(parents=True)
    (package / "some_package.py").write_text("")
    sys.path.append(str(package))
    reference = written(folder, CARS.format(more="import shared_helper, some_package"))
    (folder / "more.py").write_text(CARS.format(more="import shared_helper, some_package").replace("cars", "more"))
    assert load_file(reference).spec.code.keys() == {"cars.py", "shared_helper.py"}
    assert load_file(f"{folder / 'more.py'}:more").spec.code.keys() == {"more.py", "shared_helper.py"}
    (folder / "alone.py").write_text(CARS.format(more="").replace("cars", "alone"))
    assert load_file(f"{folder / 'alone.py'}:alone").spec.code.keys() == {"alone.py"}, "not what others import"


def test_another_code_is_another_system(folder: Path) -> None:
    before = load_file(written(folder)).spec.digest
    assert load_file(written(folder, CARS.format(more="# another comment"))).spec.digest != before


def test_a_file_of_the_name_of_a_package_that_is_loaded_before_is_no_code(folder: Path) -> None:
    (folder / "numpy.py").write_text("raise RuntimeError('executed')")
    spec = load_file(written(folder, CARS.format(more="import numpy"))).spec
    assert sorted(spec.code) == ["cars.py"]
    assert "numpy" in spec.versions


def test_modules_with_names_of_ours_harm_nothing(folder: Path) -> None:
    for name in ("schemas", "workers", "orchestrator"):
        (folder / f"{name}.py").write_text("HERE = True")
    text = CARS.format(more="import schemas, workers, orchestrator\nassert schemas.HERE and workers.HERE")
    assert sorted(load_file(written(folder, text)).spec.code) == [
        "cars.py",
        "orchestrator.py",
        "schemas.py",
        "workers.py",
    ]


@pytest.mark.parametrize(
    ("text", "name", "words"),
    [
        (None, "cars", "there is no such Python file"),
        ("def cars(:", "cars", "cars.py line 1:"),
        ("import nowhere_at_all", "cars", "cars.py line 1: ModuleNotFoundError: 'nowhere_at_all' pip"),
        (
            "raise ModuleNotFoundError('none', name='mujoco.viewer')",
            "cars",
            "cars.py line 1: ModuleNotFoundError: pip install 'perfbound[mujoco]'",
        ),
        ("\nraise SystemExit(3)", "cars", "cars.py line 2: SystemExit: 3"),
        ("\nraise BaseException('panic')", "cars", "cars.py line 2: BaseException: panic"),
        (CARS.format(more=""), "bikes", "there is no 'bikes' in it; its systems are cars; name"),
        (CARS.format(more=""), "car", "there is no 'car' in it; did you mean 'cars'? name"),
        ("def cars(x): return x", "cars", "cars function @perfbound.system"),
        (CARS.format(more="").replace("def cars(x)", "def cars(y)"), "cars", "positional y"),
    ],
)
def test_a_file_that_is_no_system_is_refused_in_one_line(folder: Path, text: str | None, name: str, words: str) -> None:
    if text is not None:
        (folder / "cars.py").write_text(text)
    with pytest.raises(DefinitionError, match=facts(words)) as fault:
        load_file(f"{folder / 'cars.py'}:{name}")
    assert "\n" not in str(fault.value)


def test_a_file_does_not_take_the_name_of_an_installed_system(folder: Path) -> None:
    text = CARS.format(more="").replace('columns={"a": "m"}', 'columns={"a": "m"}, name="segway"')
    with pytest.raises(DefinitionError, match="an installed system is called 'segway'"):
        systems.add_file(written(folder, text))
    with pytest.raises(UnknownSystemError):
        systems.load_system("cars")


# The fingerprint of the code


def test_a_late_import_is_part_of_the_code(tmp_path: Path) -> None:
    (tmp_path / "late.py").write_text("K = 2\n")
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "__init__.py").write_text("")
    (tmp_path / "tools" / "deep.py").write_text("from . import beside\n")
    (tmp_path / "tools" / "beside.py").write_text("")
    (tmp_path / "stranger.py").write_text("")
    source = SOURCE.replace("return x", "import late, scipy.linalg; from tools.deep import beside; return late.K * x")
    (tmp_path / "one.py").write_text(source)
    spec = load_file(f"{tmp_path / 'one.py'}:one").spec
    assert set(spec.code) == {"one.py", "late.py", "tools/__init__.py", "tools/deep.py", "tools/beside.py"}
    assert set(spec.versions) == {"numpy", "scipy"}


SOURCE = """
import numpy as np
import perfbound as pb
@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": ""})
def one(x):
    return x
"""


def test_the_code_of_an_installed_system_is_its_folder() -> None:
    spec = systems.load_system("segway").spec
    assert {"segway/system.py", "segway/model.urdf", "segway/__init__.py"} <= set(spec.code)
    assert not [name for name in spec.code if "__pycache__" in name]
    assert set(systems.load_system("test-function").spec.code) == {"test_function.py", "base.py"}


# Disturbances

GUSTY = {"gust": pb.Normal(0, 2, unit="m/s"), "mass": pb.Choice([0.9, 1.1], unit="kg")}


def test_disturbances_are_arguments_of_their_names() -> None:
    found = made(lambda x, *, mass, gust: (x + gust, mass), disturbances=GUSTY)
    assert [(each.name, each.unit) for each in found.spec.disturbances] == [("gust", "m/s"), ("mass", "kg")]
    assert (found.spec.residual, found.spec.noisy) == (False, ("nominal",))
    template = RequestTemplate.of(found.spec, {}, horizon=0.0, visual=False)
    request = template.request(RolloutId("robustness", 0, "nominal", 0), (0.5,), 7)
    gust, mass = request.disturbances
    file = read_mcap(run_request_on(found, request, lambda _: None))
    assert file.trajectory.samples[0].tolist() == [0.0, 0.5 + gust, mass]
    assert file.request["disturbances"] == [gust, mass], "they are part of the evidence"
    assert request.words(found.spec) == f"x = 0.5, with gust = {gust:.4g} m/s, mass = {mass:g} kg, seed 7"


def test_another_seed_gives_other_disturbances_and_a_variant_without_noise_the_medians() -> None:
    def pair(x: float, *, gust: float, mass: float, variant: str) -> Any:
        return gust, mass

    found = made(pair, disturbances=GUSTY, noisy=["true"])
    template = RequestTemplate.of(found.spec, {}, horizon=0.0, visual=False)
    true = [template.request(RolloutId("sim_gap", 0, "true", 0), (0.5,), seed).disturbances for seed in (1, 2)]
    nominal = [template.request(RolloutId("sim_gap", 0, "nominal", 0), (0.5,), seed).disturbances for seed in (1, 2)]
    assert true[0] != true[1]
    assert nominal == [(0.0, 1.1)] * 2, "the medians"


@pytest.mark.parametrize(
    ("seed", "residual", "wanted"), [(True, None, True), (True, False, False), (False, None, False)]
)
def test_what_is_random_besides_is_known(seed: bool, residual: bool | None, wanted: bool) -> None:
    with_seed, without = lambda x, *, gust, seed: (x, gust), lambda x, *, gust: (x, gust)
    laws = {"gust": pb.Normal(0, 1)}
    assert made(with_seed if seed else without, disturbances=laws, residual=residual).spec.residual is wanted


WRONG_DISTURBANCES: list[tuple[Callable[..., Any], dict[str, Any], str]] = [
    (lambda x: (x, x), {"gust": pb.Normal(0, 1)}, "takes no argument gust; name it behind the *"),
    (lambda x, *, gust=0.0: (x, x), {"gust": pb.Normal(0, 1)}, "takes no argument gust; name it behind the *"),
    (lambda x, *, gust: (x, x), {"gust": 3.0}, "gust: 3.0 is no law; write pb.Normal"),
    (lambda x, *, Gust: (x, x), {"Gust": pb.Normal(0, 1)}, "'Gust': a name consists of a-z"),
    (lambda x, *, x_: (x, x), {"x_": pb.Normal(0, 1)}, ""),
    (lambda x, *, gust: (x, x), {}, "option 'gust' needs a default"),
]


@pytest.mark.parametrize(("function", "laws", "fault"), WRONG_DISTURBANCES)
def test_disturbances_that_do_not_fit_the_function_are_refused(
    function: Callable[..., Any], laws: dict[str, Any], fault: str
) -> None:
    if not fault:
        made(function, disturbances=laws)
        return
    with pytest.raises(DefinitionError) as caught:
        made(function, disturbances=laws)
    assert fault in str(caught.value)


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        (None, "takes the disturbances gust, mass, not none"),
        ({"gust": 1.0}, "takes the disturbances gust, mass, not gust"),
        ({"gust": 1.0, "mass": math.nan}, "mass = nan is not a finite number"),
        ({"gust": 1.0, "mass": 1.0, "rain": 2.0}, "not gust, mass, rain"),
    ],
)
def test_a_rollout_takes_exactly_its_disturbances(given: dict[str, float] | None, fault: str) -> None:
    found = made(lambda x, *, mass, gust: (x, x), disturbances=GUSTY)
    with pytest.raises(SimulationError, match=fault):
        found.rollout(
            (0.5,), variant="nominal", seed=0, horizon=0.0, options={}, progress=lambda _: None, disturbances=given
        )


def test_a_request_with_disturbances_for_a_system_without_any_is_refused() -> None:
    found = made(lambda x: (x, x))
    template = RequestTemplate.of(found.spec, {}, horizon=0.0, visual=False)
    request = template.request(RolloutId("robustness", 0, "nominal", 0), (0.5,), 7)
    with pytest.raises(SimulationError, match="f has 0 disturbances, not 1"):
        run_request_on(found, request.model_copy(update={"disturbances": (1.0,)}), lambda _: None)
