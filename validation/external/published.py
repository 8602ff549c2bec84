"""Numbers that the external problems are compared with; `validation/published.toml` says whose."""

from typing import Final

from validation.published import published

_CRANK, _PENDULUM = published("crank"), published("pendulum")
# G, dG/dk, dG/dc, as printed and recomputed; q, q', dq/dk, dq/dc of the crank at t = 10.
CRANK_G_PUBLISHED, CRANK_G, CRANK_END = (_CRANK[x] for x in ("printed", "recomputed", "end"))
# t, q, x, p.
CRANK_TRAJECTORY: Final = _CRANK["trajectory"]
PENDULUM_COLUMNS: Final = tuple(_PENDULUM["columns"].tolist())
# t, then `PENDULUM_COLUMNS`.
PENDULUM: Final = _PENDULUM["table"]
# t, then x, y, vx, vy of point B_0.
FOUR_BAR: Final = published("four-bar")["table"]
