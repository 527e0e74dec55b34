"""The declaration of a disturbance: the laws that there are, their words, and what is refused."""

from collections.abc import Callable

import pytest

import perfbound as pb
from perfbound.schemas.errors import DefinitionError
from perfbound.schemas.file.disturbance import Disturbance

LAWS = [
    (pb.Normal(0, 2, unit="m/s"), "normal, mean 0 m/s, sd 2 m/s"),
    (pb.Normal(1, 2, low=0), "normal, mean 1, sd 2, low 0"),
    (pb.Uniform(0.9, 1.1, unit="kg"), "uniform, low 0.9 kg, high 1.1 kg"),
    (pb.LogNormal(2, 0.3, unit="m"), "lognormal, median 2 m, sigma 0.3"),
    (pb.Triangular(0, 1, 4), "triangular, mode 1, low 0, high 4"),
    (pb.Weibull(2, 3, unit="s"), "weibull, shape 2, scale 3 s"),
    (pb.Choice([1, 2.5], [0.25, 0.75], unit="V"), "1 V (0.25), 2.5 V (0.75)"),
    (pb.Choice([1, 2]), "1 (0.5), 2 (0.5)"),
    (pb.Law("gumbel_r", loc=0, scale=1, unit="m"), "gumbel_r, loc 0, scale 1"),
]


@pytest.mark.parametrize(("law", "words"), LAWS)
def test_a_law_has_words_and_is_the_same_after_json(law: Disturbance, words: str) -> None:
    assert law.words == words
    assert Disturbance.model_validate_json(law.model_dump_json()) == law
    named = law.named("gust", law.unit)
    assert named.name == "gust"
    assert named.named("", law.unit) == law


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: pb.Normal(0, -1), "sd: -1: it must be greater than 0"),
    (lambda: pb.Normal(0, float("nan")), "a finite number is needed"),
    (lambda: pb.Normal("a", 1), "mean: 'a': a finite number is needed"),  # type: ignore[arg-type]
    (lambda: pb.Uniform(2, 1), "low: 2 must be less than high = 1"),
    (lambda: pb.Triangular(0, 5, 4), "mode: 5 is not allowed: allowed is a number in [0, 4]"),
    (lambda: pb.LogNormal(1, 1, low=-1), "has positive values alone"),
    (lambda: pb.Choice([1, 2], [0.5, 0.6]), "they are positive and sum up to 1, not to 1.1"),
    (lambda: pb.Choice([1, 2], [1.0]), "one probability for each of them"),
    (lambda: Disturbance(unit="m"), "a disturbance needs a law"),
    (lambda: Disturbance(distribution="normal", mean=0, sd=1, choices=(1.0,)), "choices: not together with"),
    (lambda: Disturbance(choices=(1.0, 2.0), low=0.0), "low: not together with choices"),
    (lambda: Disturbance(distribution="triangular", mode=1.0), "low: required by distribution 'triangular'"),
    (lambda: Disturbance(low=0.0, high=1.0, numbers={"loc": 1.0}), "numbers: they belong to scipy"),
    (lambda: Disturbance(distribution="normal", mean=0.0, sd=1.0, scale=3.0), "scale: belongs to distribution"),
]


@pytest.mark.parametrize(("made", "fault"), REFUSED)
def test_what_is_no_law_is_refused_in_one_line(made: Callable[[], object], fault: str) -> None:
    with pytest.raises(DefinitionError) as caught:
        made()
    assert fault in str(caught.value)
    assert "\n" not in str(caught.value)
