"""Studies as files: what is refused, which cells follow, what the table says."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from workbench.errors import StudyError
from workbench.params import Parameters
from workbench.studies.analysis import beside_published, effects, means, optimum
from workbench.studies.design import (
    Fractional,
    Study,
    cells_of,
    flight_overrides,
    load_study,
    parameters_of,
    reduced,
    shipped_studies,
)
from workbench.studies.responses import require_groups

BASE = {"name": "s", "title": "t", "scene": "meadow", "responses": ["counts"]}


def study(**values):
    return Study(**(BASE | {"factors": {"thin": [1, 2]}} | values))


def test_full_design_has_every_combination_and_seed():
    cells = cells_of(study(factors={"thin": [1, 2], "match.inflight": [1, 2, 3]}, seeds=[4, 5]))
    assert len(cells) == 12
    assert len(set(cells)) == 12
    assert dict(cells[0].levels) == {"thin": 1, "match.inflight": 1}


def test_levels_may_be_lists():
    chosen = study(factors={"match.downscales": [[1], [1, 2, 3]]})
    cells = cells_of(chosen)
    assert len(set(cells)) == 2
    assert parameters_of(chosen, cells[1], Parameters()).match.downscales == (1, 2, 3)


def test_fractional_design_uses_every_level_evenly():
    cells = cells_of(
        study(
            factors={"thin": [1, 2, 3], "match.inflight": [1, 2, 3], "flight.wind": [0.0, 2.0, 4.0]},
            design=Fractional(runs=9),
        )
    )
    assert len(cells) == 9
    for factor in ("thin", "match.inflight", "flight.wind"):
        used = pd.Series([dict(cell.levels)[factor] for cell in cells]).value_counts()
        assert used.tolist() == [3, 3, 3]


def test_levels_reach_the_flight_and_the_parameters():
    one = cells_of(study(factors={"flight.gsd": [0.1], "surface.min_count": [2]}, seeds=[7]))[0]
    chosen = study(factors={"flight.gsd": [0.1], "surface.min_count": [2]}, fixed={"match.inflight": 2})
    assert flight_overrides(chosen, one) == {"gsd": 0.1}
    parameters = parameters_of(chosen, one, Parameters())
    assert (parameters.surface.min_count, parameters.match.inflight) == (2, 2)
    assert (parameters.simulate.seed, parameters.orient.seed) == (7, 7)


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ({"match.colour": [1]}, "no factor 'match.colour'"),
        ({"colour": [1]}, "no factor 'colour'"),
        ({"match.inflight": [-3]}, "match.inflight"),
        ({"flight.wing": [1]}, "wing"),
        ({"flight.wind": [-5]}, "wind"),
        ({"thin": [0]}, "thin is 0"),
    ],
)
def test_unknown_factors_and_levels_are_named_before_anything_runs(factors, words):
    with pytest.raises(StudyError, match=words):
        cells_of(study(factors=factors))


def test_impossible_studies_are_refused(tmp_path):
    with pytest.raises(StudyError, match="No study 'nothing'"):
        load_study("nothing", tmp_path)
    path = tmp_path / "wrong.yaml"
    path.write_text("name: Wrong Name\ntitle: t\nfactors: {}\nresponses: []\n")
    with pytest.raises(StudyError) as error:
        load_study(path)
    for field in ("name", "factors", "responses"):
        assert f"{field}:" in str(error.value)
    path.write_text("name: a\ntitle: t\nfactors: {thin: [1]}\nresponses: [counts]\n")
    with pytest.raises(StudyError, match="either scene or site"):
        load_study(path)
    with pytest.raises(StudyError, match="choose from"):
        require_groups(["beauty"])


def test_own_studies_are_found_and_reduced(tmp_path):
    folder = tmp_path / "data" / "studies"
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text(
        "name: mine\ntitle: t\nscene: meadow\nfactors: {thin: [1, 2, 3]}\nresponses: [counts]\n"
        "quick: {factors: {thin: [1, 3]}, seeds: [9]}\n"
    )
    quick = load_study("mine", tmp_path, quick=True)
    assert (quick.name, quick.factors, quick.seeds) == ("mine-quick", {"thin": [1, 3]}, [9])
    with pytest.raises(StudyError, match="unknown factors"):
        reduced(study(quick={"factors": {"flight.wind": [1]}}))


@pytest.mark.parametrize("name", shipped_studies())
@pytest.mark.parametrize("quick", [False, True])
def test_every_shipped_study_is_possible(name, quick):
    shipped = load_study(name, quick=quick)
    require_groups(shipped.responses)
    assert cells_of(shipped)


@pytest.fixture
def table():
    """value = 3 a + 2 b + noise of the seed."""
    rows = []
    for a in (0, 1, 2):
        for b in (0, 1):
            for seed, noise in ((1, -0.1), (2, 0.1)):
                rows.append((a, b, seed, "y", 3 * a + 2 * b + noise, "%"))
    return pd.DataFrame(rows, columns=["a", "b", "seed", "response", "value", "unit"])


def test_means_have_intervals_over_seeds(table):
    result = means(table, "y").set_index(["a", "b"])
    assert result["mean"][1, 1] == pytest.approx(5)
    # Two values 0.2 apart: t(0.975, 1) = 12.706, standard error 0.1.
    assert result["high"][1, 1] - 5 == pytest.approx(12.706 * 0.1, rel=1e-3)
    assert means(table[table.seed == 1], "y")["low"].isna().all()


def test_effects_add_up_and_find_no_interaction(table):
    result = effects(table, "y").set_index("source")
    assert result["share"].sum() == pytest.approx(1)
    assert result["range"]["a"] == pytest.approx(6)
    assert result["share"]["a x b"] == pytest.approx(0, abs=1e-12)
    crossed = table.assign(value=table["a"] * table["b"])
    assert effects(crossed, "y").set_index("source")["share"]["a x b"] > 0.1


def test_optimum_says_how_sure_it_is(table):
    result = optimum(table, "y", best="lowest")
    assert (result["a"][0], result["b"][0], result["wins"][0]) == (0, 0, 1.0)
    assert optimum(table, "y", best="highest")["mean"][0] == pytest.approx(8)
    tie = table.assign(value=np.random.default_rng(1).normal(size=len(table)))
    assert optimum(tie, "y", best="lowest")["wins"].max() < 1


def test_ranks_beside_published(table):
    ours = means(table, "y")
    published = pd.DataFrame({"a": [0, 1, 2], "b": [0, 0, 0], "percent": [1.0, 5.0, 30.0]})
    merged, rho, _ = beside_published(ours, published, ["a", "b"], "percent")
    assert merged["simulated"].tolist() == pytest.approx([0, 3, 6])
    assert rho == pytest.approx(1)


def test_a_response_that_is_not_there_is_named(table):
    with pytest.raises(StudyError, match="no response 'z', but y"):
        means(table, "z")
