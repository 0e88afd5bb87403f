"""Which kinds of values a Habitat dataset's JSON files hold where. habitat-sim ignores a value of another kind, mostly in silence.

A shape is one of: a function that says what is wrong with a value; a dictionary of shapes by key (a key that ends in
`?` may be missing, `*` stands for every other key; keys that are not listed are none of ours); a list of one shape,
for a list of such values; a pair of a value and a shape, for that value or one of the shape.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Shape = Callable[[Any], str | None] | Mapping[str, Any] | list[Any] | tuple[Any, Any]


def mismatch(value: Any, shape: Any, where: str = "") -> str | None:
    """The first place where a value does not have a shape, and why; None when it has it."""
    if isinstance(shape, tuple):
        return None if value == shape[0] else mismatch(value, shape[1], where)
    if callable(shape):
        wrong = shape(value)
        return f"{where or 'the file'} {wrong}" if wrong else None
    if isinstance(shape, list):
        if not isinstance(value, list):
            return f"{where or 'the file'} is no list"
        inner = shape[0]
        if callable(inner):  # most lists are of numbers: their places are named when one is wrong
            wrong = next(((i, problem) for i, item in enumerate(value) if (problem := inner(item))), None)
            return f"{where}[{wrong[0]}] {wrong[1]}" if wrong else None
        return next((problem for i, item in enumerate(value) if (problem := mismatch(item, inner, f"{where}[{i}]"))), None)
    if not isinstance(value, dict):
        return f"{where or 'the file'} is no object"
    for key, inner in shape.items():
        name = key.removesuffix("?")
        if name == "*":
            named = {other.removesuffix("?") for other in shape}
            rest = {k: v for k, v in value.items() if k not in named}
            problem = next((f for k, v in rest.items() if (f := mismatch(v, inner, f"{where}.{k}".lstrip(".")))), None)
        elif name in value:
            problem = mismatch(value[name], inner, f"{where}.{name}".lstrip("."))
        else:
            problem = None if key.endswith("?") else f"{where or 'the file'} has no {name}"
        if problem:
            return problem
    return None


def conforming(value: Any, shape: Any, where: str = "") -> tuple[Any, list[str]]:
    """The parts of a value that have a shape, and the problem of each other part.

    An object loses the keys that are wrong. In a list of objects, a wrong one becomes an empty object, so that the others
    keep their places; a list of texts loses the wrong ones. Any other wrong value is None.
    """
    if isinstance(shape, Mapping) and isinstance(value, dict):
        return _conforming_keys(value, shape, where)
    item_shape = shape[0] if isinstance(shape, list) else None
    if isinstance(value, list) and (isinstance(item_shape, Mapping) or item_shape is text):
        checked = [(item, mismatch(item, item_shape, f"{where}[{index}]")) for index, item in enumerate(value)]
        is_text = item_shape is text
        items = [{} if wrong else item for item, wrong in checked if not (wrong and is_text)]
        return items, [wrong for _, wrong in checked if wrong]
    problem = mismatch(value, shape, where)
    return (None, [problem]) if problem else (value, [])


def _conforming_keys(value: dict[str, Any], shape: Mapping[str, Any], where: str) -> tuple[Any, list[str]]:
    inner_shapes = {key.removesuffix("?"): inner for key, inner in shape.items()}
    values: dict[str, Any] = {}
    problems: list[str] = []
    for key, item in value.items():
        inner = inner_shapes.get(key, inner_shapes.get("*", anything))
        part, wrong = conforming(item, inner, f"{where}.{key}".lstrip("."))
        problems += wrong
        if part is not None or (item is None and not wrong):
            values[key] = part
    missing = [key for key in shape if key != "*" and not key.endswith("?") and key not in values]
    problems += [f"{where or 'the file'} has no {key}" for key in missing if key not in value]
    return (None if missing else values), problems


def text(value: Any) -> str | None:
    """A text."""
    return None if isinstance(value, str) else "is no text"


def truth(value: Any) -> str | None:
    """True or false."""
    return None if isinstance(value, bool) else "is neither true nor false"


def number(value: Any) -> str | None:
    """A finite number, and no farther from zero than anything in a scene."""
    fine = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9
    return None if fine else "is no finite number"


def whole(value: Any) -> str | None:
    """A whole number."""
    return None if isinstance(value, int) and not isinstance(value, bool) else "is no whole number"


def scale(value: Any) -> str | None:
    """Three numbers other than zero; a negative one mirrors."""
    fine = isinstance(value, list) and len(value) == 3 and all(number(item) is None and item != 0 for item in value)
    return None if fine else "is not three numbers other than zero"


def anything(value: Any) -> str | None:
    """Any value: what it must be is another rule's."""
    return None


def action(value: Any) -> str | None:
    """An action by number or name, or none."""
    fine = value is None or isinstance(value, str) or (isinstance(value, int) and not isinstance(value, bool) and value >= 0)
    return None if fine else "is no action"


_ABOUT = {
    "render_asset?": text, "collision_asset?": text, "semantic_asset?": text, "nav_asset?": text, "up?": [number], "front?": [number],
    "scale?": scale, "units_to_meters?": number, "margin?": number, "friction_coefficient?": number, "restitution_coefficient?": number,
    "is_collidable?": truth, "force_flat_shading?": truth, "shader_type?": text,
}  # fmt: skip
_STAGE = {**_ABOUT, "gravity?": [number], "origin?": [number]}
_OBJECT = {
    **_ABOUT, "mass?": number, "COM?": [number], "inertia?": [number], "semantic_id?": whole, "join_collision_meshes?": truth,
    "use_bounding_box_for_collision?": truth,
}  # fmt: skip
_PLACED = {
    "template_name?": text, "translation?": [number], "rotation?": [number], "translation_origin?": text, "motion_type?": text,
    "uniform_scale?": number, "non_uniform_scale?": scale, "mass_scale?": number, "user_defined?": {},
}  # fmt: skip
_SCENE = {
    "stage_instance?": _PLACED, "object_instances?": [_PLACED], "translation_origin?": text, "default_lighting?": text,
    "navmesh_instance?": text, "semantic_scene_instance?": text, "user_defined?": {"object_count?": whole},
}  # fmt: skip
_LIGHT = {"position?": [number], "direction?": [number], "intensity?": number, "color?": [number], "type?": text}
_LIGHTS: Mapping[str, Any] = {"lights?": ([], {"*": _LIGHT})}  # habitat-sim passes over any other list
SECTIONS: Mapping[str, Any] = {"stages": _STAGE, "objects": _OBJECT, "light_setups": _LIGHTS, "scene_instances": _SCENE}
"""Shape of the files of every section of a scene dataset config."""

_LISTED = {
    "default_attributes?": {}, "paths?": {"*": [text]},
    "configs?": [{"original_file?": text, "template_handle?": text, "attributes?": {}}],
}  # fmt: skip
CONFIG: Mapping[str, Any] = {
    **{f"{name}?": _LISTED for name in SECTIONS},
    "navmesh_instances?": {"*": text},
    "semantic_scene_descriptor_instances?": {"default_attributes?": {}, "paths?": {"*": [text]}, "*": text},
}
LEXICON: Mapping[str, Any] = {"classes?": [{"id": whole, "name": text}]}
AGENT: Mapping[str, Any] = {
    "radius": number, "height": number, "max_climb": number, "max_slope": number, "navmesh_include_static_objects": truth,
    "forward_step_size?": number, "turn_angle?": number, "success_distance?": number,
}  # fmt: skip
_MAPS = {
    "category_to_task_category_id?": {"*": whole}, "category_to_scene_annotation_category_id?": {"*": whole},
    "category_to_mp3d_category_id?": {"*": whole},
}  # fmt: skip
_STATE = {"position?": (None, [number]), "rotation?": (None, [number]), "action?": action}
_VIEW = {"agent_state?": {"position?": [number], "rotation?": [number]}, "iou?": anything}
_GOAL = {
    "position?": [number], "radius?": (None, number), "object_id?": anything, "object_name?": (None, text),
    "object_name_id?": (None, whole), "object_category?": (None, text), "room_id?": anything, "room_name?": anything,
    "view_points?": (None, [_VIEW]),
}  # fmt: skip
_EPISODE = {
    "episode_id?": anything, "scene_id?": text, "scene_dataset_config?": text, "additional_obj_config_paths?": [text],
    "start_position?": [number], "start_rotation?": [number], "info?": (None, {"*": anything}), "goals?": [_GOAL],
    "start_room?": (None, text), "object_category?": text, "shortest_paths?": (None, [[anything]]),
}  # fmt: skip
SPLIT: Mapping[str, Any] = {**_MAPS, "episodes?": [_EPISODE]}
CONTENT: Mapping[str, Any] = {**_MAPS, "episodes?": [_EPISODE], "goals_by_category?": {"*": [_GOAL]}}
STATE: Mapping[str, Any] = _STATE
"""Shape of a state in a shortest path that is no bare action."""
