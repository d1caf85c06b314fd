"""The tags and attributes that URDF knows."""

from __future__ import annotations

# What URDF knows inside each element: children, then attributes. Unknown names are extensions unless nearly known ones.
SCHEMA: dict[str, tuple[str, str]] = {
    "robot": ("link joint material transmission gazebo ros2_control sensor", "name version"),
    "link": ("inertial visual collision contact", "name type"),
    "inertial": ("origin mass inertia", ""),
    "visual": ("origin geometry material", "name"),
    "collision": ("origin geometry material verbose", "name"),
    "geometry": ("box cylinder sphere mesh capsule", ""),
    "material": ("color texture", "name"),
    "joint": ("origin parent child axis calibration dynamics limit mimic safety_controller", "name type"),
    "origin": ("", "xyz rpy"),
    "mass": ("", "value"),
    "inertia": ("", "ixx ixy ixz iyy iyz izz"),
    "parent": ("", "link"),
    "child": ("", "link"),
    "axis": ("", "xyz"),
    "limit": ("", "lower upper effort velocity acceleration jerk"),
    "dynamics": ("", "damping friction"),
    "calibration": ("", "rising falling reference_position"),
    "safety_controller": ("", "soft_lower_limit soft_upper_limit k_position k_velocity"),
    "mimic": ("", "joint multiplier offset"),
    "box": ("", "size"),
    "cylinder": ("", "radius length"),
    "sphere": ("", "radius"),
    "capsule": ("", "radius length"),
    "mesh": ("", "filename scale"),
    "color": ("", "rgba"),
    "texture": ("", "filename"),
}
KNOWN = {tag: (frozenset(children.split()), frozenset(keys.split())) for tag, (children, keys) in SCHEMA.items()}

# What may stand once in an element.
ONCE = {
    "link": ("inertial",),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
    "geometry": ("shape",),
}
