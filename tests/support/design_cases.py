"""Scenes with the design variables that tests of the assembler differentiate in."""

from ancfdae import DesignVariable, distributed_variables
from ancfdae.model.elements import ALL_ELEMENTS

MATERIAL = ("youngs_modulus", "poisson_ratio", "density")
ALL = (*MATERIAL, "width", "height", "length", "damping_time")


def of(beam, *parameters):
    return [f"{beam}.{parameter}" for parameter in parameters]


#: Scene and design; together every parameter of every scene, one variable for several beams and
#: one variable per element.
CASES = {
    "planar, all": ("one_planar_beam", of("rod", *ALL)),
    "planar, none": ("one_planar_beam", []),
    # One variable that enters the mass alone, one that enters the elastic force alone.
    "planar, inertial": ("one_planar_beam", of("rod", "density")),
    "planar, elastic": ("one_planar_beam", of("rod", "poisson_ratio")),
    "pair, one each": ("planar_pair", [*of("crank", "width", "length"), *of("rod", *ALL)]),
    "pair, shared": (
        "planar_pair",
        [
            DesignVariable("E", ["rod.youngs_modulus", "crank.youngs_modulus[2]"]),
            DesignVariable("rho", ["crank.density[0]", "crank.density[1]"]),
            DesignVariable("h", ["rod.height", "crank.height[1]"]),
        ],
    ),
    "pair, per element": (
        "planar_pair",
        [
            *distributed_variables("crank.height", 3),
            *distributed_variables("rod.poisson_ratio", 2),
            "crank.length",
        ],
    ),
    "mixed, curved": ("planar_mixed", [*of("bow", *MATERIAL, "width", "length"), "rod.length"]),
    "mixed, per element": (
        "planar_mixed",
        [
            *distributed_variables("bow.height", 2),
            DesignVariable("nu", ["rod.poisson_ratio"]),
            DesignVariable("h", ["rod.height"]),
            DesignVariable("w", ["bow.width[0]", "bow.width[1]"]),
        ],
    ),
    "cables": (
        "planar_cables",
        [*of("rod", *ALL), "rope.length", *distributed_variables("rope.height", 2)],
    ),
    "spatial, all": ("one_spatial_beam", of("rod", *ALL)),
    "spatial pair": (
        "spatial_pair",
        [*distributed_variables("crank.height", 2), "crank.length", *of("rod", *ALL)],
    ),
    "spatial mixed": (
        "spatial_mixed",
        [*of("coil", *ALL), "rod.length", DesignVariable("E", ["rod.youngs_modulus"])],
    ),
    "spatial, shared": (
        "spatial_mixed",
        [DesignVariable("nothing but coil", ["coil.height[1]", "coil.height[0]"])],
    ),
    "damped pair": (
        "damped_pair",
        [
            *of("crank", *ALL),
            *distributed_variables("rod.height", 1),
            DesignVariable("E", ["rod.youngs_modulus"]),
        ],
    ),
    "planar machine, elements": (
        "planar_machine",
        [*of("rod", *ALL), "crank.length", "bow.length", "crank.damping_time"],
    ),
    "planar machine, parts": (
        "planar_machine",
        [
            *of("motor", "speed", "offset", "acceleration"),
            *of("slot", "direction_x", "direction_y"),
            *of("link", "length"),
            *of("shaker", "amplitude", "frequency", "phase", "offset"),
            *of("stay", "length", "ground_x", "ground_y"),
            *of("weight", "force_x", "force_y"),
            DesignVariable("load", ["snow.force_x"]),
            *of("jet", "force_x", "force_y"),
            *of("strut", "stiffness", "damping", "free_length"),
            DesignVariable("both", ["rod.damping_time[0]", "rod.damping_time[1]"]),
        ],
    ),
    "spatial machine": (
        "spatial_machine",
        [
            *of("crank", "length", "damping_time", "youngs_modulus"),
            *of("coil", "length", "height", "damping_time"),
            *of("bearing", "axis_x", "axis_y", "axis_z"),
            *of("elbow", "axis_x", "axis_z"),
            *of("motor", "amplitude", "frequency", "phase"),
            *of("slot", "direction_z", "through_x"),
            *of("jet", "force_z"),
            *of("snow", "force_y"),
            *of("strut", "stiffness", "ground_z"),
        ],
    ),
    "planar bodies": (
        "planar_bodies",
        [
            *of("arm", "mass", "inertia", "centre_x", "centre_y"),
            *of("wheel", "radius", "length", "density", "centre_y"),
            *of("load", "mass"),
            *of("link", "length"),
            *of("strut", "stiffness", "damping"),
        ],
    ),
    "planar carriers": (
        "planar_carriers",
        [
            *of("rod", "length", "height", "damping_time"),
            *of("arm", "length", "density", "youngs_modulus", "height[1]"),
            *of("bow", "length", "height[0]", "width"),
            *of("box", "length", "height", "width", "density", "centre_x"),
            *of("bead", "mass"),
            *of("knot", "mass"),
            DesignVariable("m", ["load.mass"]),
            *of("snow", "force_y"),
        ],
    ),
    "spatial carriers": (
        "spatial_carriers",
        [
            *of("rod", "length", "width"),
            *of("coil", "length", "height", "density", "poisson_ratio"),
            *of("body", "mass", "inertia_xx", "inertia_xy", "inertia_yz", "centre_z"),
            *of("ball", "radius", "density", "centre_z"),
            *of("bead", "mass"),
            *of("elbow", "axis_x"),
        ],
    ),
    "cable carriers": (
        "cable_carriers",
        [*of("rope", "length", "height"), *of("rod", "length", "width"), "box.height"],
    ),
}


CASES |= {f"{element.name}, all": (element.name, of("rod", *ALL)) for element in ALL_ELEMENTS}
