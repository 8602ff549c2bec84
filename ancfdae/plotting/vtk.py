"""Export for ParaView: moving surfaces of the bodies, with fields.

Files are written by pyevtk: pure Python with NumPy, maintained, and made for this purpose, VTK's
XML with raw arrays. The package vtk itself is 140 MB, and meshio, which reads the files back in the
tests, has had no release since January 2024.
"""

import os
import shutil
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ancfdae.equations import Solution
from ancfdae.equations.files import replacing_path, saving
from ancfdae.errors.checks import require_package
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.elements import Quantity
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.plotting.mechanism import Mechanism, mechanism
from ancfdae.plotting.pictures import checked_path
from ancfdae.plotting.shapes import (
    BeamMesh,
    Mesh,
    StrainEnergyDensity,
    VonMisesStress,
    section_forces,
)

_QUAD = 9  # type of a cell with four corners, in the VTK file formats
_FORCES = ("N [N]", "V_y [N]", "V_z [N]", "T [N m]", "M_y [N m]", "M_z [N m]")
_PLANAR = (0, 1, 5)


def write_vtk(
    scene: Scene,
    solution: Solution,
    path: str | os.PathLike[str],
    times: Sequence[float] | None = None,
) -> Path:
    """Write a motion for ParaView: a .pvd, which lists one .vtu per time in a folder beside it.

    Points have displacement from the configuration as declared, velocity, von Mises stress (not if
    there are cables, or in space sections without a shape), strain energy density, forces and
    moments of the section, and the derivative of the position in each design variable of the
    solution; cells have the number of their body. Quantities that a body does not have are NaN.

    Parameters
    ----------
    scene, solution
        As in `snapshots`.
    path : str or path
        Ends with ``.pvd``.
    times : sequence of float, optional
        Times to write, by default all times of the solution; s.

    Raises
    ------
    InvalidInputError, MissingPackageError
        As in `snapshots`; if no body has a surface; without pyevtk, which ``pip install
        "ancfdae[vtk]"`` installs.
    SaveError
        If a file cannot be written, for example on a full disk; existing files are kept.
    """
    file = checked_path("write_vtk", path, (".pvd",))
    evtk = require_package("write_vtk", "pyevtk.hl", "vtk")
    group = require_package("write_vtk", "pyevtk.vtk", "vtk")
    shown, declared = mechanism(scene, solution, times, None), mechanism(scene, None, None, None)
    if not len(shown.faces):
        raise InvalidInputError(
            "write_vtk, scene",
            "needs a beam or a body with a surface",
            "rigid bodies without a shape",
            "Give one a shape, for example RigidBox(0.1, 0.1, 0.1).",
        )
    with saving("folder", file.parent):
        folder = _folder_beside(file)
    data = point_data(shown, declared)
    # The files of all times are written to a temporary folder, then replace old ones together.
    with replacing_path("write_vtk", file) as listed, _folder_for(folder) as new:
        series = group.VtkGroup(str(listed.with_suffix("")))
        for k, t in enumerate(shown.motion.t.tolist()):
            written = Path(_instant(evtk, new / f"{k:05d}", shown, data, k))
            series.addFile(str(folder / written.name), sim_time=t)
        series.save()
        for path in sorted(new.iterdir()):
            path.replace(folder / path.name)
    return file


def _instant(evtk: Any, path: Path, shown: Mechanism, data: dict[str, Array], k: int) -> str:
    """Write the surface with its fields at time index k; return the path with its suffix."""
    faces = shown.faces
    bodies = np.repeat(np.arange(len(shown.meshes)), [len(mesh.faces) for mesh in shown.meshes])
    return str(
        evtk.unstructuredGridToVTK(
            str(path),
            *_components(np.concatenate([place[k] for place in shown.places])),
            connectivity=faces.ravel(),
            offsets=4 * np.arange(1, len(faces) + 1),
            cell_types=np.full(len(faces), _QUAD, dtype=np.uint8),
            cellData={"body": bodies},
            pointData={name: _at(x, k) for name, x in data.items()},
        )
    )


@contextmanager
def _folder_for(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `folder` for its new files, removed afterwards."""
    new = folder.with_name(f"{folder.name}.{uuid.uuid4().hex}.part")
    new.mkdir()
    try:
        yield new
    finally:
        shutil.rmtree(new, ignore_errors=True)


def _at(field: Array, k: int) -> Any:
    return _components(field[k]) if field.ndim == 3 else np.ascontiguousarray(field[k])


def _folder_beside(file: Path) -> Path:
    """Return the folder with the name of `file` without suffix; create it if it is missing."""
    folder = file.with_suffix("")
    if folder.is_file():
        rule = "must leave the name without suffix free for a folder"
        repair = "Choose another name, or remove that file."
        raise InvalidInputError("write_vtk, path", rule, f"the file {folder}", repair)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def point_data(shown: Mechanism, declared: Mechanism) -> dict[str, Array]:
    """Return fields at all points by name: vectors (k, n, d) or scalars (k, n)."""
    motion = shown.motion
    x = np.concatenate(shown.places, axis=1)
    data = {
        "displacement [m]": x - np.concatenate(declared.places, axis=1),
        "velocity [m/s]": _joined(shown, lambda mesh: mesh.velocities(motion.q, motion.v)),
        "strain energy density [J/m^3]": _joined(
            shown, lambda mesh: StrainEnergyDensity().values(mesh, motion)
        ),
    }
    if all(_has_stress(mesh) for mesh in shown.meshes):
        data["von Mises stress [Pa]"] = _joined(
            shown, lambda mesh: VonMisesStress().values(mesh, motion)
        )
    forces = _joined(shown, lambda mesh: _section_forces(mesh, motion))
    for component in _PLANAR if shown.d == 2 else range(6):
        data[_FORCES[component]] = forces[..., component]
    if motion.sensitivities is not None:
        q_b = motion.sensitivities.q_b
        for i, name in enumerate(motion.sensitivities.names):
            data[f"d place/d {name}"] = _joined(
                shown, lambda mesh, i=i: mesh.sensitivities(motion.q, q_b[..., i], i)
            )
    return data


def _joined(shown: Mechanism, function: Any) -> Array:
    return np.concatenate([function(mesh) for mesh in shown.meshes], axis=1)


def _has_stress(mesh: Mesh) -> bool:
    if not isinstance(mesh, BeamMesh):
        return True
    shaped = mesh.body.dimension == 2 or mesh.body.element_type().section.shaped
    return shaped and Quantity.SLOPE_Y in mesh.body.element.quantities


def _section_forces(mesh: Mesh, motion: Solution) -> Array:
    """Return the section forces and moments at all points, shape (k, n, 6); NaN for others."""
    k = len(motion.t)
    if not isinstance(mesh, BeamMesh) or mesh.elements is None:
        return np.full((*mesh.places(motion.q).shape[:2], 6), np.nan)
    forces = section_forces(mesh, motion)[..., None, :]
    return np.broadcast_to(forces, (k, *mesh.shape, 6)).reshape(k, -1, 6)


def _components(x: Array) -> tuple[Array, Array, Array]:
    """Return the components of vectors, (n, d), as three arrays, the third zero in the plane."""
    columns = [np.ascontiguousarray(x[:, axis]) for axis in range(x.shape[1])]
    return (*columns, np.zeros(len(x)))[:3]  # type: ignore[return-value]
