"""Plots are refused when they would show nothing, and are otherwise reproducible and readable."""

import itertools
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from ancfdae.errors import InvalidInputError
from ancfdae.plotting import Figure, Panel, Series, draw, save

T = np.linspace(0.0, 1.0, 201)
SINE = Series("sine", T, np.sin(9.0 * T))
COSINE = Series("cosine", T, np.cos(9.0 * T))


def panel(*series: Series, title: str = "Motion") -> Panel:
    return Panel(title, "t [s]", "y [m]", series)


def two_panels() -> Figure:
    return draw([panel(SINE, COSINE), panel(COSINE, title="Again")], columns=2, title="Both")


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ([0.0, 1.0], [0.0]),
        ([], []),
        ([[0.0, 1.0]], [[0.0, 1.0]]),
        ([0.0, 1.0], [1.0j, 2.0j]),
        ([0.0, 1.0], [np.nan, np.inf]),
        ([0.0, np.nan], [np.nan, 1.0]),
    ],
    ids=["lengths", "empty", "matrix", "complex", "nothing finite", "no finite pair"],
)
def test_series_that_cannot_be_drawn_is_refused(x: object, y: object) -> None:
    with pytest.raises(InvalidInputError, match="Series 'curve'"):
        Series("curve", x, y)


@pytest.mark.parametrize("label", ["", "  ", "_hidden"])
def test_label_that_the_legend_would_drop_is_refused(label: str) -> None:
    with pytest.raises(InvalidInputError, match=r"Series\.label"):
        Series(label, T, T)


def test_series_without_line_and_marker_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="line or markers"):
        Series("nothing", T, T, line=False)


def test_panel_without_series_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="at least one series"):
        panel()


def test_panel_with_one_label_for_two_series_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="each label once"):
        panel(SINE, Series("sine", T, T))


@pytest.mark.parametrize("label", ["", " ", "[s]", "t [s] later", "t []", "t [s"])
def test_axis_label_without_quantity_or_with_half_a_unit_is_refused(label: str) -> None:
    with pytest.raises(InvalidInputError, match="unit in brackets"):
        Panel("Motion", label, "y [m]", [SINE])
    with pytest.raises(InvalidInputError, match="unit in brackets"):
        Panel("Motion", "t [s]", label, [SINE])


def test_a_number_without_unit_has_its_name_alone() -> None:
    figure = draw([Panel("Convergence", "number of elements", "error", [SINE])])
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == (
        "number of elements",
        "error",
    )


def test_panel_without_title_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"Panel\.title"):
        panel(SINE, title=" ")


def test_unknown_scale_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="'linear' or 'log'"):
        Panel("Motion", "t [s]", "y [m]", [SINE], y_scale="symlog")


def test_series_that_a_logarithmic_axis_cannot_show_is_refused() -> None:
    below = Series("below", [1.0, 2.0], [-1.0, 0.0])
    assert Panel("Fine", "t [s]", "y [m]", [below], x_scale="log").series == [below]
    with pytest.raises(InvalidInputError, match="'below': at least one point must be positive"):
        Panel("Lost", "t [s]", "y [m]", [below], y_scale="log")


def test_nothing_to_draw_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="at least one panel"):
        draw([])
    with pytest.raises(InvalidInputError, match="one column"):
        draw([panel(SINE)], columns=0)


def test_label_with_two_looks_is_refused() -> None:
    marked = Series("sine", T, np.sin(9.0 * T), marker=True)
    with pytest.raises(InvalidInputError, match="same in every panel"):
        draw([panel(SINE), panel(marked)])


def test_axes_show_what_the_panel_declares() -> None:
    error = Panel(
        "Error", "h [s]", "error [-]", [Series("h", [0.1, 1.0], [1e-3, 0.0])], "log", "log"
    )
    axes = draw([error]).axes[0]
    assert (axes.get_title(), axes.get_xlabel(), axes.get_ylabel()) == (
        "Error",
        "h [s]",
        "error [-]",
    )
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    np.testing.assert_array_equal(axes.lines[0].get_xydata(), [[0.1, 1e-3], [1.0, 0.0]])


@pytest.mark.parametrize(
    ("end", "beside", "above"),
    [(9.0, [2, 5], [2, 5]), (32.0, [3, 30], [2, 5, 20]), (2000.0, [], [])],
)
def test_short_logarithmic_axis_labels_numbers_between_powers_of_ten(
    end: float, beside: list[int], above: list[int], tmp_path: Path
) -> None:
    series = [Series("e", [1.0, end], [1.0, end])]
    figure = draw([Panel("Work", "t [s]", "e [-]", series, "log", "log")])
    save(figure, tmp_path / "work")
    for axis, labelled in ((figure.axes[0].xaxis, beside), (figure.axes[0].yaxis, above)):
        ticks = zip(axis.get_minorticklocs(), axis.get_minorticklabels(), strict=True)
        shown = [round(x) for x, text in ticks if text.get_text() and 1 < x < end]
        assert shown == labelled


def test_label_looks_the_same_in_every_panel_and_is_listed_once() -> None:
    figure = two_panels()
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["sine", "cosine"]
    first, second = figure.axes[0].lines[1], figure.axes[1].lines[0]
    assert first.get_color() == second.get_color()
    assert first.get_linestyle() == second.get_linestyle()


def test_overlapping_series_differ_in_colour_and_dashes_and_later_ones_are_thinner() -> None:
    lines = draw([panel(*(Series(f"{k}", T, T) for k in range(4)))]).axes[0].lines
    for earlier, later in itertools.combinations(lines, 2):
        assert earlier.get_color() != later.get_color()
        assert earlier._dash_pattern != later._dash_pattern
        assert earlier.get_linewidth() > later.get_linewidth()
        assert earlier.get_zorder() < later.get_zorder()


def test_28_series_are_all_told_apart() -> None:
    lines = draw([panel(*(Series(f"{k}", T, T) for k in range(28)))]).axes[0].lines
    looks = {(line.get_color(), line._unscaled_dash_pattern) for line in lines}
    assert len(looks) == 28


def test_dashes_and_markers_can_be_demanded() -> None:
    solid, dashed, marks = (
        draw(
            [
                panel(
                    Series("solid", T, T),
                    Series("dashed", T, T + 1.0, dashed=True),
                    Series("marks", T, T + 2.0, line=False, marker=True),
                )
            ]
        )
        .axes[0]
        .lines
    )
    assert solid.get_linestyle() == "-"
    assert dashed.get_linestyle() == "--"
    assert marks.get_linestyle() == "None"
    assert marks.get_marker() not in ("None", "", None)


def test_first_series_is_dashed_and_second_solid_on_demand() -> None:
    lines = (
        draw([panel(Series("a", T, T, dashed=True), Series("b", T, T, dashed=False))]).axes[0].lines
    )
    assert [line.get_linestyle() for line in lines] == ["--", "-"]


def test_legend_covers_no_panel() -> None:
    figure = draw([panel(*(Series(f"series number {k}", T, T) for k in range(9)))])
    figure.draw_without_rendering()
    top_of_legend = figure.legends[0].get_window_extent().y1
    assert top_of_legend <= figure.axes[0].get_tightbbox().y0
    assert figure.legends[0].get_window_extent().x0 >= 0.0
    assert figure.legends[0].get_window_extent().x1 <= figure.bbox.x1


def test_saved_files_are_a_picture_each(tmp_path: Path) -> None:
    svg, png = save(two_panels(), tmp_path / "new folder" / "motion-2.5")
    assert (svg.name, png.name) == ("motion-2.5.svg", "motion-2.5.png")
    assert ElementTree.parse(svg).getroot().tag == "{http://www.w3.org/2000/svg}svg"
    assert png.read_bytes().startswith(b"\x89PNG\r\n")


def test_same_declaration_gives_the_same_bytes(tmp_path: Path) -> None:
    once = save(two_panels(), tmp_path / "once")
    again = save(two_panels(), tmp_path / "again")
    assert [path.read_bytes() for path in once] == [path.read_bytes() for path in again]
    assert b"<dc:date>" not in once[0].read_bytes()


def test_neither_reads_nor_changes_the_settings_of_the_user(tmp_path: Path) -> None:
    plain = save(two_panels(), tmp_path / "plain")[0].read_bytes()
    with mpl.rc_context({"font.size": 30.0, "axes.facecolor": "black", "svg.hashsalt": "mine"}):
        before = dict(mpl.rcParams)
        assert save(two_panels(), tmp_path / "user")[0].read_bytes() == plain
        assert dict(mpl.rcParams) == before


@pytest.mark.parametrize("name", ["motion.svg", "motion.png"])
def test_a_suffix_asks_for_one_file_alone_with_the_same_bytes(tmp_path: Path, name: str) -> None:
    (file,) = save(two_panels(), tmp_path / "alone" / name)
    assert [path.name for path in file.parent.iterdir()] == [name]
    both = {path.name: path.read_bytes() for path in save(two_panels(), tmp_path / "motion")}
    assert file.read_bytes() == both[name]


def faces(figure: Figure) -> dict[str, tuple[object, ...]]:
    lines = [line for axes in figure.axes for line in axes.lines]
    handles = dict(zip([t.get_text() for t in figure.legends[0].get_texts()], lines, strict=False))
    return {
        label: (line.get_color(), line.get_marker(), line.get_markerfacecolor())
        for label, line in handles.items()
    }


def test_a_method_looks_the_same_in_every_figure_and_panel() -> None:
    names = ["IDA", "HHT fixed, alpha = -0.3", "something else", "DOP853"]
    some = [Series(name, T, T, marker=True) for name in names]
    first = draw([panel(*some), panel(*some)])
    other = draw([panel(*reversed(some[:2]), Series("IDAS", T, T, marker=True))])
    assert faces(first)["IDA"] == faces(other)["IDA"]
    alpha = r"HHT fixed, $\alpha$ = -0.3"
    assert faces(first)[alpha] == faces(other)[alpha]
    assert len({look[:2] for look in faces(first).values()}) == 4
    colours = [[line.get_color() for line in axes.lines] for axes in first.axes]
    assert colours[0] == colours[1]


def test_two_variants_of_a_method_share_its_colour_and_are_told_apart() -> None:
    names = ["HHT fixed, alpha = -0.3", "HHT fixed, alpha = -0.05"]
    one, two = faces(draw([panel(*(Series(n, T, T, marker=True) for n in names))])).values()
    assert one[0] == two[0]
    assert one[2] != two[2]


def test_points_at_one_place_are_all_seen_over_the_lines() -> None:
    series = [
        Series("discrete adjoint", T, T, line=False, marker=True),
        Series("continuous adjoint", T, T, line=False, marker=True),
        Series("direct differentiation", T, T),
    ]
    discrete, continuous, line = draw([panel(*series)]).axes[0].lines
    assert line.get_zorder() < discrete.get_zorder() < continuous.get_zorder()
    assert discrete.get_markersize() > continuous.get_markersize() + 2
    (single,) = draw([panel(Series("truth", [1], [1], line=False, marker=True))]).axes[0].lines
    assert single.get_markersize() > 10


def test_letters_of_three_panels_are_as_large_as_those_of_one_at_the_same_width() -> None:
    def size(columns: int) -> float:
        figure = draw([panel(Series("a", T, T)) for _ in range(columns)], columns=columns)
        return figure.axes[0].title.get_fontsize() / figure.get_size_inches()[0]

    # At the width of one panel, letters of three are more than half as large.
    assert size(3) > 0.55 * size(1)


@pytest.mark.parametrize(
    ("plain", "set_"),
    [
        ("rho_1 · dΨ/drho_1 [m² s]", r"$\rho_{1}$ · dΨ/$d\rho_{1}$ [m² s]"),
        ("step 2^-7 s, E = 1e7 N/m²", "step $2^{-7}$ s, E = $10^{7}$ N/m²"),
        ("3.5e-04, 1e+07", r"$3.5\times 10^{-4}$, $10^{7}$"),
        ("accelerations, hht_alpha = -0.3", r"accelerations, $\alpha$ = -0.3"),
        ("omega²/omega²(0) [-]", r"$\omega$²/$\omega$²(0) [-]"),
        ("dx/dE_1 of the Deltas, alphabet, rod_a", "dx/$dE_{1}$ of the Deltas, alphabet, rod_a"),
        ("$x_1$ and rho", "$x_1$ and rho"),
    ],
)
def test_symbols_are_set_as_mathematics(plain: str, set_: str) -> None:
    drawn = draw([Panel(plain, "t [s]", "x [m]", [Series("a", T, T)])])
    assert drawn.axes[0].get_title() == set_
    drawn.draw_without_rendering()


def test_points_of_every_series_have_a_marker_of_their_own() -> None:
    ways = ["HHT, fixed", "HHT, controlled", "IDA", "DOP853"]
    names = [f"{way}, {levels} levels" for way in ways for levels in (2, 3)]
    series = [Series(name, T, T, line=False, marker=True) for name in names]
    assert len({line.get_marker() for line in draw([panel(*series)]).axes[0].lines}) == 8


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_powers_of_ten_do_not_run_into_each_other(columns: int) -> None:
    x = np.logspace(-13, -1, 13)
    panels = [Panel(str(n), "x [-]", "y [-]", [Series("s", x, x)], "log", "log") for n in range(3)]
    figure = draw(panels, columns)
    figure.draw_without_rendering()
    for axes in figure.axes:
        low, high = axes.get_xlim()
        ticks = zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)
        labels = [label for place, label in ticks if low <= place <= high]
        boxes = [label.get_window_extent() for label in labels]
        assert len(boxes) >= 3
        assert all(b.x0 - a.x1 > 3 for a, b in itertools.pairwise(boxes))
