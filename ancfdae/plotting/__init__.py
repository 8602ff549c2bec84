"""Pictures and animations of mechanisms, and line plots; only this package imports matplotlib."""

from ancfdae.plotting.charts import Figure, Panel, Scale, Series, draw, save
from ancfdae.plotting.derivatives import gradient_bars, history
from ancfdae.plotting.pictures import Film, animate, snapshots
from ancfdae.plotting.shapes import (
    AxialForce,
    BendingMoment,
    Field,
    Sensitivity,
    Speed,
    StrainEnergyDensity,
    VonMisesStress,
)
from ancfdae.plotting.vtk import write_vtk

__all__ = [
    "AxialForce",
    "BendingMoment",
    "Field",
    "Figure",
    "Film",
    "Panel",
    "Scale",
    "Sensitivity",
    "Series",
    "Speed",
    "StrainEnergyDensity",
    "VonMisesStress",
    "animate",
    "draw",
    "gradient_bars",
    "history",
    "save",
    "snapshots",
    "write_vtk",
]
