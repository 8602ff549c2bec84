"""Ladders of models: what each rung neglects, which is chosen, meshes beside steps."""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    HHT,
    AtTimes,
    Beam,
    CurvedBeam,
    DesignVariable,
    Integral,
    Material,
    Pin,
    Scene,
    assemble,
    choose_model,
    error_bars,
    gradient,
    simulate,
    work_precision,
)
from ancfdae.errors import InvalidInputError, NoAccurateModelError
from ancfdae.model.design import as_design
from ancfdae.observables import position, von_mises
from ancfdae.sections import Rectangle
from ancfdae.studies.ladder import (
    ModelComparison,
    ModelVariant,
    Question,
    VariantRun,
    _is_fine,
    _mesh_bar,
    error,
)
from ancfdae.studies.meshes import coarsest, known_design, model_kinds, with_mesh
from validation.design.coupler_path import hoeken

DESIGN = ["arm.height", "arm.youngs_modulus"]
T_END = 0.3


def swinging(elements=2, **changes):
    material = Material(4000, 3e8, 0.3, damping_time=2e-3)
    arm = Beam("arm", (0, 0), (1.2, 0), elements, Rectangle(0.05, 0.05), material)
    return Scene([replace(arm, **changes)], [Pin(arm.at_start, name="pin")], gravity=(0, -9.81))


SINK = Integral(position(swinging().beams[0].at_end, 1) ** 2)


@pytest.fixture(scope="module")
def ladder():
    return choose_model(swinging(4), SINK, T_END, 0.02, design=DESIGN)


def test_rungs_are_those_that_the_scene_has(ladder):
    names = list(dict.fromkeys(rung.name for rung in ladder.rungs))
    assert names == ["rigid", "all CABLE_2D", "undamped", "as declared"]
    assert [x.elements for x in ladder.rungs if x.name == "as declared"] == [1, 2, 4, 8]
    # One that deforms has no rung of its own; without damping and rigid nothing is left.
    assert [kind.name for kind in model_kinds(swinging(rigid=True), {})] == ["as declared"]


def test_numbers_of_a_rung_are_those_of_the_call(ladder):
    rung = ladder.rungs[-2]
    run = rung.runs[-1]
    answer = gradient(rung.scene, SINK, T_END, run.integrator, design=rung.design)
    b = assemble(rung.scene, rung.design).b
    assert np.array_equal(run.numbers, [answer.value, *(answer.gradient * b)])


def test_rigid_is_right_for_the_motion_and_wrong_for_the_gradient(ladder):
    (rigid,) = (rung for rung in ladder.rungs if rung.name == "rigid")
    assert ladder.without_influence(rigid) == ("arm.youngs_modulus",)
    value, slope = (ladder.choice(rigid, rigid.runs[-1], of) for of in ("objective", "gradient"))
    assert value.parts["model"] < 0.02 < 0.5 < slope.parts["model"]
    assert "arm.youngs_modulus" in ladder.table()
    # Its derivative in the height, the mass cancelling, is that of a rod of other inertia.
    assert rigid.numbers[2] == 0.0 != rigid.numbers[1]


def test_the_chosen_rung_is_within_the_tolerance_of_twice_the_mesh(ladder):
    richest, of = ladder.richest, "gradient"
    scene, design = with_mesh(richest.scene, richest.design, 1)
    step = richest.runs[-1].step / 2
    answer = gradient(scene, SINK, T_END, HHT(step), design=design)
    truth = np.array([answer.value, *(answer.gradient * assemble(scene, design).b)])
    for tolerance in (0.02, 0.1):
        chosen = ladder.recommend(tolerance, of)
        assert chosen.error <= tolerance
        assert error(chosen.run.numbers - truth, truth, of) <= tolerance
        assert chosen.rung.name != "rigid"
        cheaper = [x for x in ladder.choices(of) if x.run.work < chosen.run.work]
        assert all(x.error > tolerance for x in cheaper)


def test_parts_add_up_to_at_least_the_distance_from_the_richest(ladder):
    exact = ladder.richest.numbers
    for of in ("objective", "gradient"):
        for each in ladder.choices(of):
            away = error(each.run.numbers - exact, exact, of)
            # Equal where one part is all there is: round-off of three differences.
            assert away <= each.error * (1 + 1e-12) + 1e-15
            assert set(each.parts) == {"model", "mesh", "step", "reference"}
        (last,) = (x for x in ladder.choices(of) if x.run is ladder.richest.runs[-1])
        assert last.parts["model"] == last.parts["mesh"] == 0.0 < last.parts["reference"]


def made_up(*rows):
    """A ladder of rungs of one run each: work, seconds, value and gradient; the last is exact."""
    runs = [VariantRun(0.1, work, seconds, np.array(numbers)) for work, seconds, *numbers in rows]
    rungs = [
        ModelVariant(f"model {k}", 0, "done", runs=(x,), bar=np.zeros(2))
        for k, x in enumerate(runs)
    ]
    return ModelComparison(tuple(rungs), ("b",), 0.01, np.zeros(2), np.full(2, np.nan))


def test_both_value_and_gradient_are_within_the_tolerance():
    # Errors: the value 4.9 %, the gradient 4.9 %, both 0.5 and 0.9 %, none.
    found = made_up((10, 1, 1.049, 2), (20, 1, 1, 2.098), (30, 1, 1.005, 2.018), (40, 1, 1, 2))
    assert found.chosen.rung.name == "model 2"
    assert found.chosen.of == "gradient"
    assert found.chosen.error == pytest.approx(0.009)
    assert "error 0.009 in the gradient" in repr(found.chosen)
    assert found.recommend(0.01, "gradient").rung.name == "model 0"
    assert found.recommend(0.01, "objective").rung.name == "model 1"
    assert found.recommend(0.06).rung.name == "model 0"
    with pytest.raises(
        NoAccurateModelError, match="in the objective and the gradient; the best is model 3"
    ):
        replace(found, mesh_bar=np.array([0.1, 0.2])).recommend(0.01)


def test_the_choice_does_not_depend_on_measured_times():
    rows = (
        (10, 9.0, 1.5, 2),
        (30, 1.0, 1, 2.001),
        (20, 5.0, 1, 2.001),
        (20, 7.0, 1, 2),
        (40, 0, 1, 2),
    )
    # Of two with the same work the more accurate one.
    assert made_up(*rows).chosen.rung.name == "model 3"


def test_work_is_steps_times_unknowns(ladder):
    for rung in ladder.rungs:
        system = assemble(rung.scene)
        for run in rung.runs:
            assert run.work == round(T_END / run.step) * (system.n_q + system.n_lam)


def test_a_step_may_take_an_eighth_of_the_tolerance_or_of_the_error_of_the_model():
    question = Question(SINK, T_END, (), np.ones(2), 0.1, 8192)
    numbers, exact = (
        np.array([1.5, 2.0]),
        ModelVariant("", 0, "", runs=(VariantRun(0, 0, 0, np.ones(2)),)),
    )
    for kind in np.eye(2):
        assert question.is_small(kind * 0.1 / 8 * 0.999, np.ones(2), None)
        assert not question.is_small(kind * 0.1 / 8 * 1.001, np.ones(2), None)
        # The model errs by 0.5 in the value and by 1 in the gradient.
        allowed = kind @ [0.5, 1.0] / 8
        assert question.is_small(kind * allowed * 0.999, numbers, exact)
        assert not question.is_small(kind * allowed * 1.001, numbers, exact)


def test_a_mesh_may_take_a_quarter_of_the_tolerance_by_elements_of_second_order(ladder):
    # Of two meshes, Roache's index at order p: 3 d / (2^p - 1), p = 2 (docs/reports/elements).
    def meshes(d):
        numbers = np.ones(2) + d, np.ones(2)
        return [
            ModelVariant("", k, "", runs=(VariantRun(0, 0, 0, x),)) for k, x in enumerate(numbers)
        ]

    for kind in np.eye(2):
        np.testing.assert_allclose(_mesh_bar(meshes(0.01 * kind))[0], 3 * 0.01 * kind / 3)
        assert _is_fine(meshes(kind * 0.1 / 4 * 0.999), 0.1)
        assert not _is_fine(meshes(kind * 0.1 / 4 * 1.001), 0.1)
    x = [rung.numbers for rung in ladder.rungs if rung.name == "as declared"][-3:]
    d = np.abs(np.diff(x, axis=0))
    # Of three, at the order seen, at most 2: 1.25 d / (2^p - 1), d a quarter of the first at least.
    p = np.clip(np.log2(d[0] / d[1]), 0.5, 2.0)
    np.testing.assert_allclose(ladder.mesh_bar, 1.25 * np.maximum(d[1], d[0] / 4) / (2**p - 1))


def test_what_cannot_be_reached_is_said(ladder):
    with pytest.raises(
        NoAccurateModelError, match=r"error of 1e-12 in the objective; the best is"
    ) as told:
        ladder.recommend(1e-12, "objective")
    assert told.value.best.error == min(x.error for x in ladder.choices("objective"))
    with pytest.raises(InvalidInputError, match="objective, gradient"):
        ladder.choices("states")


def test_rigid_beams_have_no_stress_and_the_table_says_so():
    stress = AtTimes(von_mises(swinging().beams[0].at(0.5, y=0.02)) / 1e6, 0.1)
    ladder = choose_model(swinging(), stress, 0.1, 0.5, design=["arm.height"])
    rigid = ladder.rungs[0]
    assert not rigid.runs
    assert "must deform" in rigid.outcome
    assert rigid.outcome in ladder.table()


def test_models_of_ones_own_are_rungs():
    other = swinging(material=Material(4000, 2e8, 0.3))
    ladder = choose_model(
        swinging(), SINK, T_END, 0.5, design=["arm.height"], alternatives={"stiffer": other}
    )
    (own,) = (x for x in ladder.rungs if x.name == "stiffer" and x.level == 0)
    assert own.scene.beams[0].material.youngs_modulus == 2e8
    leg = replace(swinging().beams[0], name="leg")
    wrong = Scene([leg], [Pin(leg.at_start)], gravity=(0, -9.81))
    told = choose_model(
        swinging(), SINK, T_END, 0.5, design=["arm.height"], alternatives={"leg": wrong}
    )
    (rung,) = (each for each in told.rungs if each.name == "leg")
    assert "arm" in rung.outcome
    assert not rung.runs


def test_a_variable_of_an_element_follows_it_to_other_meshes():
    scene = swinging(2)
    pair = DesignVariable("second", {"arm.height[1]": 1.0})
    fine, design = with_mesh(scene, (pair,), 1)
    assert fine.beams[0].elements == 4
    assert design == (DesignVariable("second", {"arm.height[2]": 1.0, "arm.height[3]": 1.0}),)
    thick = scene.with_values({"arm.height[1]": 0.06})
    sizes = [section.height for section in with_mesh(thick, (), 1)[0].beams[0].section]
    assert sizes == [0.05, 0.05, 0.06, 0.06]
    with pytest.raises(InvalidInputError, match="one section and one material"):
        with_mesh(thick, (), -1)
    with pytest.raises(InvalidInputError, match="coarser"):
        with_mesh(scene, (pair,), -1)
    assert [coarsest(swinging(n)) for n in (1, 2, 3, 4, 8)] == [0, -1, 0, -2, -2]


def test_a_beam_with_another_number_of_elements_is_the_same_beam():
    beam = swinging(3).beams[0]
    assert beam.with_elements(3) is beam
    moved = simulate(swinging(3), 0.02, HHT(0.01)).position(beam.at_end)
    again = replace(swinging(3), beams=[beam.with_elements(6).with_elements(3)])
    assert np.array_equal(simulate(again, 0.02, HHT(0.01)).position(beam.at_end), moved)
    frames = np.repeat(np.eye(2)[None], 2, axis=0)
    curved = CurvedBeam("arc", [[0, 0], [1, 0]], frames, Rectangle(0.1, 0.1), beam.material)
    with pytest.raises(InvalidInputError, match="nodes are given"):
        curved.with_elements(2)


def test_variables_that_a_model_lacks_are_left_out():
    variables = as_design([*DESIGN, "arm.damping_time"])
    names = [x.name for x in known_design(swinging(), variables, "damping_time")]
    assert names == DESIGN
    several = DesignVariable("E", ["arm.youngs_modulus", "leg.youngs_modulus"])
    (kept,) = known_design(swinging(), (several,))
    assert kept == DesignVariable("E", ("arm.youngs_modulus",))


@pytest.mark.parametrize("meshes", [2, 3])
def test_bars_of_mesh_and_step_hold_together_and_by_themselves(meshes):
    call = swinging(2), SINK, T_END, HHT(T_END / 64)
    found = error_bars(*call, design=DESIGN, meshes=meshes, levels=3)
    steps = error_bars(*call, design=DESIGN, levels=3)
    assert set(found.parts) == {"step", "mesh"}
    assert set(steps.parts) == {"step"}
    scene, design = with_mesh(swinging(2), as_design(DESIGN), meshes + 1)
    exact = gradient(scene, SINK, T_END, HHT(T_END / 2048), design=design)
    assert abs(found.value - exact.value) <= found.value_bar
    assert np.all(np.abs(found.gradient - exact.gradient) <= found.gradient_bar)
    # Without the mesh the bars are those of the step alone, and too small.
    assert np.any(np.abs(steps.gradient - exact.gradient) > steps.gradient_bar)
    assert np.array_equal(found.gradient_bar, sum(x[1:] for x in found.parts.values()))
    assert np.all(np.isnan(found.mesh_orders)) == (meshes == 2)
    assert "bar of mesh" in repr(found)


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"meshes": 4}, "meshes: must be 1, 2 or 3"),
        ({"model": assemble(swinging(), DESIGN), "design": None, "meshes": 2}, "model"),
    ],
)
def test_meshes_that_make_no_sense_are_refused(changes, rule):
    call = {"model": swinging(), "design": DESIGN} | changes
    with pytest.raises(InvalidInputError, match=rule):
        error_bars(objective=SINK, t_end=T_END, integrator=HHT(0.01), **call)


def test_tradeoff_ranks_models_beside_settings():
    settings = [HHT(T_END / n) for n in (32, 128)]
    trade = work_precision(
        swinging(),
        SINK,
        T_END,
        settings,
        design=DESIGN,
        models={"rigid": swinging(rigid=True)},
        reference=HHT(T_END / 1024),
    )
    own, rigid = trade.rows[:2], trade.rows[2:]
    assert [row.model for row in trade.rows] == ["", "", "rigid", "rigid"]
    assert rigid[0].family == f"rigid, {own[0].family}"
    assert all(row.states is None and row.finished for row in rigid)
    assert all(row.objective < 0.02 and row.gradient > 0.5 for row in rigid)
    assert trade.recommend(0.1) in own
    assert trade.recommend(0.02, "objective") in trade.rows


def test_stress_gradients_where_coordinates_of_others_lie_between():
    scene = hoeken(4)
    stress = Integral((von_mises(scene.beams[1].at(0.5, y=0.003)) / 1e6) ** 2)
    design, call = ["coupler.height"], (0.02, HHT(0.001))
    found = gradient(scene, stress, *call, design=design)
    height = scene.beams[1].section.height
    moved = [
        gradient(scene.with_values({"coupler.height": x}), stress, *call, design=design).value
        for x in (height * (1 - 1e-5), height * (1 + 1e-5))
    ]
    # Central differences of 1e-5: 1e-10 relative, above that round-off of runs, 1e-12 / 1e-5.
    assert found.gradient[0] == pytest.approx((moved[1] - moved[0]) / (2e-5 * height), rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"scene": assemble(swinging(), DESIGN)}, "scene"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"doublings": 0}, "doublings"),
        ({"design": []}, "design"),
    ],
)
def test_questions_that_make_no_sense_are_refused(changes, rule):
    call = {"scene": swinging(), "tolerance": 0.1, "design": DESIGN} | changes
    with pytest.raises(InvalidInputError, match=rule):
        choose_model(objective=SINK, t_end=T_END, **call)
