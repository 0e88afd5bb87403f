"""A node of a lineage in a few words: a headline, and lines of detail. What the lake does not record is said to be so."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from schemas.lineage import Node

Facts = Mapping[str, Any]

UNRECORDED = "not recorded"

_SHOWN = 6
"""Members of a list that are spelled out; the JSON form has all."""


def described(node: Node) -> list[str]:
    """A headline and lines of detail of a node."""
    if node.is_missing:
        return [f"{node.kind} {node.key}: NAMED, BUT NOT THERE"]
    lines = _WORDS[node.kind](node.key, node.facts) if node.kind in _WORDS else [f"{node.kind} {node.key}", _listed(node.facts)]
    return [line for line in lines if line]


def number(value: Any, digits: int = 3) -> str:
    """A number in short, None as not recorded."""
    if value is None:
        return UNRECORDED
    if isinstance(value, int):
        return f"{value:,}"
    if 0 < abs(value) < 10**-digits / 2:
        return f"{'-' if value < 0 else ''}<{10**-digits:.{digits}f}"
    text = f"{value:.{digits}f}"
    return text.rstrip("0").rstrip(".") if digits else text


def scaled(value: Any, factor: float, digits: int = 1) -> str:
    """A number in another unit, None as not recorded."""
    return number(None if value is None else value * factor, digits)


def point(value: Any) -> str:
    """A point in meters."""
    return UNRECORDED if value is None else f"({', '.join(number(coordinate) for coordinate in value)})"


def _text(value: Any) -> str:
    if value is None or value == "":
        return UNRECORDED
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return number(value)
    if isinstance(value, list):
        shown = ", ".join(map(_text, value[:_SHOWN]))
        return f"{shown}, and {len(value) - _SHOWN} more" if len(value) > _SHOWN else shown or "none"
    if isinstance(value, dict):
        return _listed(value)
    return " ".join(str(value).split())


def _listed(facts: Facts) -> str:
    return ", ".join(f"{name} {_text(value)}" for name, value in facts.items() if name != "type")


def _size(values: Any) -> str:
    return UNRECORDED if values is None else " x ".join(number(length, 2) for length in values) + " m"


def _bytes(count: Any) -> str:
    if count is None:
        return UNRECORDED
    return f"{count:,} bytes" if count < 10_000 else f"{count / 1e6:.2f} MB"


def _plural(count: Any, singular: str, many: str = "") -> str:
    return f"{number(count)} {singular if count == 1 else many or singular + 's'}"


def _instance(key: str, facts: Facts) -> list[str]:
    by = facts.get("found_by")
    if facts.get("is_drawn"):
        labeled = "drawn by a model"
    elif by in (None, "file", "objects"):
        labeled = f"labeled {facts['raw_label']!r} in the scan"
    else:
        sure = facts.get("category_probability")
        labeled = f"not named in the scan, found by {by}" + ("" if sure is None else f" (category with probability {sure:.2f})")
    names = f"{labeled}, NYU40 {facts['nyu40_label']}"
    size = f"box {_size(facts['box_size'])}, {number(facts['box_volume_m3'])} m3, {_plural(facts['point_count'], 'point')}"
    return [f"{facts['category']} {key}{' (part of the room)' if facts['is_structure'] else ''}", names, size]


def _verdict(facts: Facts) -> str:
    if not facts["passed"]:
        return f"DID NOT PASS: {_text(facts['broken_rules'])}"
    return f"passed, {_plural(facts['rules'], 'rule')}" if facts["rules"] is not None else f"passed, rules {UNRECORDED}"


def _export(key: str, facts: Facts) -> list[str]:
    return [f"{facts['file']}:{facts['name']}", _verdict(facts)]


_OF_ASSETS = ("asset", "object", "collision", "texture")
"""Roles of files that come from an asset."""


def _export_file(key: str, facts: Facts) -> list[str]:
    also = f"also in {_text(facts['also_in'])}" if facts.get("also_in") else ""
    here = f"the copy outside the lake: {facts['content']}" if facts.get("content") else ""
    what = f"{facts['role']} file of {facts['scene_id']}, {_bytes(facts['size_bytes'])}, {_verdict(facts)}"
    names = facts.get("assets")
    if facts["role"] in _OF_ASSETS and names == []:
        what += f"; its asset is {UNRECORDED} in it"
    return [facts["file"], what, f"blob {facts['file_blob']}", here, also]


def _proposer(facts: Facts) -> str:
    """Who chose an asset; an imported dataset says at most that people did."""
    if facts["origin"] == "annotation":
        return f"annotator {facts['annotator']}" if facts["annotator"] is not None else "annotators of the imported dataset"
    return {"imported": "the imported dataset", "synthesis": "the model that drew it"}.get(facts["origin"], "selection")


def _placement(key: str, facts: Facts) -> list[str]:
    who = _proposer(facts) + (f" ({facts['annotation_match']})" if facts["annotation_match"] is not None else "")
    way = f"from {point(facts['proposed_position_m'])} to {point(facts['optimized_position_m'])} m"
    moved = f"{way}: {number(facts['displacement_m'])} m aside, {number(facts['lift_m'])} m up, by the {facts['method']} method"
    if facts["displacement_m"] is None:  # one pose is all that there is of it
        moved = f"at {point(facts['optimized_position_m'])} m, by the {facts['method']} method"
    before, after = facts["proposed_contacts"], facts["optimized_contacts"]
    overlaps = f"overlapped {_text(before)} ({scaled(facts['proposed_penetration_m'], 1e3)} mm deep) before, " if before else ""
    overlaps += f"{_text(after)} ({scaled(facts['optimized_penetration_m'], 1e3)} mm deep) after" if after else "overlaps nothing"
    if facts["method"] == "imported":  # nobody looked for overlaps
        overlaps = f"overlaps {UNRECORDED}"
    absent = f"not in {_text(facts['not_in'])}" if facts.get("not_in") else ""
    remains = f"remains: {facts['remains']}" if facts["remains"] else ""
    return [f"placement {key}, proposed by {who}", moved, overlaps, absent, remains]


def _support(key: str, facts: Facts) -> list[str]:
    relation, carrier, against = facts["relation"], facts["parent_id"] or "", facts["against"] or ""
    if relation == "none" and facts["bracket_blob"] is not None:
        relation, carrier = "bracket", f"at {against or UNRECORDED}"
    elif relation == "floor":
        carrier = f"against {against}" if against else ""
    elif relation != "none":
        carrier = carrier or against or UNRECORDED
    kind = "fixed" if facts["is_fixed"] else "free to move"
    kept = "" if facts["is_kept"] else ", by something else after the optimization"
    return [f"{relation} {carrier}".strip() + f", gap {scaled(facts['gap_m'], 1e3)} mm, {kind}{kept}"]


def _moves(key: str, facts: Facts) -> list[str]:
    carried = f", {_plural(facts['of_what_carries_it'], 'step')} of what carries it" if facts["of_what_carries_it"] else ""
    steps = [
        f"step {row['step']}: {row['instance_id']} {row['outcome']} by {point((row['dx_m'], row['dy_m'], row['dz_m']))} m{_turned(row)}"
        for row in facts["steps"][:_SHOWN]
    ]
    more = f"and {len(facts['steps']) - _SHOWN} more" if len(facts["steps"]) > _SHOWN else ""
    return [f"{_plural(facts['own'], 'step')} of its own{carried}" if facts["steps"] else "no step: it stands as proposed", *steps, more]


def _turned(step: Facts) -> str:
    angle = math.degrees(math.hypot(step["turn_x_radians"], step["turn_y_radians"], step["turn_z_radians"]))
    return f", turned by {number(angle, 1)} degrees" if angle else ""


def _certificate(key: str, facts: Facts) -> list[str]:
    engine = f"{facts['engine']} {facts['engine_version']}"
    if facts["problem"]:
        return [f"{engine} could not simulate it: {facts['problem']}"]
    went = f"{scaled(facts['displacement_m'], 1e3)} mm and {scaled(facts['tilt_radians'], 180 / math.pi)} degrees"
    verdict = "stable" if facts["is_stable_5cm"] else "NOT STABLE"
    nudged = {True: ", also after nudges", False: ", NOT STABLE after a nudge", None: ""}[facts["is_stable_nudged"]]
    plausible = {True: "plausible", False: "NOT PLAUSIBLE", None: "not judged"}[facts["is_density_plausible"]]
    mass = f"{number(facts['mass_kg'])} kg, {number(facts['density_kg_m3'], 0)} kg/m3, {plausible}"
    return [
        f"{engine}: {verdict}, moved {went} in {number(facts['simulated_seconds'])} s{' (fixed)' if facts['is_fixed'] else nudged}",
        mass,
    ]


def _episodes(key: str, facts: Facts) -> list[str]:
    if not facts["count"]:
        return [f"no episode: {facts['reason']}"]
    return [
        f"{_plural(facts['count'], 'episode')} ({facts['split']}) for {facts['agent']}, {facts['path_finder']}: {_text(facts['episodes'])}"
    ]


def _selection(key: str, facts: Facts) -> list[str]:
    scores = f"coverage {number(facts['coverage'])}, box IoU {number(facts['box_iou'])}, Chamfer {number(facts['chamfer_m'])} m"
    who = f"scored by {facts['provider']} {facts['provider_version']}: {scores}, color {number(facts['color_similarity'])}"
    return [f"rank {facts['rank']} of {facts['ranked']}, score {number(facts['score'])}", who]


def _annotation(key: str, facts: Facts) -> list[str]:
    chose = f"chose asset {facts['choice'][:12]}" if facts["choice"] else "found that no candidate fits"
    where = f", placed at {point(facts['position_m'])} m" if facts["position_m"] else ""
    named = f"as instance {facts['instance_id']}, from {facts['source_file']}"
    returned = " (returned: it counts no more)" if facts.get("is_returned") else ""
    return [
        f"{facts['annotator']} in batch {facts['batch_id']}{returned} {chose}{where}",
        f"{named}, answered {moment(facts['answered_at'])}",
    ]


def _candidate(key: str, facts: Facts) -> list[str]:
    made = f"slot {facts['slot']}, {facts['outcome']}{' by a fallback' if facts['is_fallback'] else ''}"
    return [made, f"because {facts['reason']}" if facts["reason"] else ""]


def _provider(key: str, facts: Facts) -> list[str]:
    settings = facts["settings"]
    listed = _listed({k: v for k, v in settings.items() if k != "version"}) if isinstance(settings, Mapping) else UNRECORDED
    return [f"provider {facts['provider']}, version {_text(facts['provider_version'])}", f"settings: {listed or 'none'}"]


def _asset(key: str, facts: Facts) -> list[str]:
    shape = f"{_size(facts['extents'])}, {number(facts['volume_m3'], 4)} m3, {'closed' if facts['is_watertight'] else 'open'}"
    source = f"source {_text(facts['source'])}, license {_text(facts['license'])}, author {_text(facts['author'])}"
    return [f"asset {key}", f"{facts['name']} ({facts['category']}), {shape}, {_plural(facts['face_count'], 'face')}", source]


def _library_model(key: str, facts: Facts) -> list[str]:
    """Where it was found. Of a library that was removed or indexed again since, only that is known."""
    where = f"library {facts['library']}" if facts["library"] is not None else "a folder"
    lines = [f"{where}, file {facts['file']}, score {number(facts['score'], 3)}"]
    if facts["is_indexed"] is None:
        return lines
    if not facts["is_indexed"]:
        return [*lines, "not there any more: the library was removed or indexed again"]
    terms = f"license {_text(facts['license'])}{', no commercial use' if facts['is_noncommercial'] else ''}"
    known = f"{facts['format']} in units of {number(facts['unit_m'])} m ({facts['unit_known']}), {facts['up']} up ({facts['up_known']})"
    source = f"author {_text(facts['author'])}, published at {_text(facts['source_url'])}"
    return [*lines, f"{terms}, {source}", f"{known}, category {facts['category']} ({facts['category_known']})", *facts["notes"]]


def _caption(key: str, facts: Facts) -> list[str]:
    body = f"{facts['body_type']}, {_text(facts['materials'])}, {number(facts['mass_kg'])} kg, friction {number(facts['friction'])}"
    return [
        facts["sentence"],
        f"{body}; attributes from {_text(facts['attribute_source'])}{'; by a fallback' if facts['is_fallback'] else ''}",
    ]


def _model_call(key: str, facts: Facts) -> list[str]:
    """A call with its prompt and reply, line by line."""
    tokens = f"{number(facts['prompt_tokens'])} tokens sent, {number(facts['reply_tokens'])} came back"
    lost = f", {_plural(facts['lost'], 'call')} lost before" if facts["lost"] else ""
    took = f"{facts['outcome']} after {_plural(facts['attempts'], 'request')} in {number(facts['seconds'])} s{lost}"
    head = f"{facts['model']}{' ' + facts['model_version'] if facts['model_version'] else ''}, call {key[:12]}"
    prompt = f"prompt {facts['prompt']} {facts['prompt_version']}, {moment(facts['asked_at'])}"
    lines = [f"{name}: {line}" for name in ("asked", "answered") for line in str(facts.get(name) or "").splitlines() if line.strip()]
    return [f"{head}, {prompt}", f"{took}; {tokens}; {number(facts['cost_usd'])} USD", *lines]


def _mask(key: str, facts: Facts) -> list[str]:
    box, seen = facts["pixel_box"], facts["visible_share"]
    return [f"{_plural(facts['pixel_count'], 'pixel')} in {box[0]}..{box[2]} x {box[1]}..{box[3]}, {scaled(seen, 100, 0)} % of it visible"]


def _frame(key: str, facts: Facts) -> list[str]:
    camera = f"camera at {point(facts['camera_position_m'])} m" if facts["has_pose"] else "without a pose"
    files = f"{facts['color_file']}, depth {_text(facts['depth_file'])}"
    return [f"frame {key.rpartition('/')[2]}: {files}, {facts['width']} x {facts['height']}, {camera}"]


def _scene(key: str, facts: Facts) -> list[str]:
    size = f"{_plural(facts['instance_count'], 'instance')} from {facts['segmentation']}, {_plural(facts['frame_count'], 'frame')}"
    mesh = f"mesh of {_plural(facts['face_count'], 'face')}, aligned: {facts['alignment_source']}"
    return [f"scene {key}, room {facts['room_id']}", f"{size}, {mesh}"]


def _scan(key: str, facts: Facts) -> list[str]:
    return [
        f"{facts['scan_format']} scan {facts['scan']} of {facts['dataset']}, license {_text(facts['license'])}",
        f"files in {_text(facts['scan_path'])}",
        f"hash of its files {_text(facts['content_hash'])}",
    ]


def _synthesis(key: str, facts: Facts) -> list[str]:
    share = facts["stable_share"]
    stable = f", {scaled(share, 100, 0)} % of them stable as drawn" if share is not None else ""
    which = f"layout {facts['number']} of seed {facts['seed']}, by {facts['model_kind']}"
    return [
        f"{facts['category']} of {_size(facts['box_size'])}, room type {facts['room_type']}; {which}",
        f"{_plural(facts['object_count'], 'object')}, {facts['colliding_count']} in others, {facts['off_support_count']} off{stable}",
    ]


def _drawing(key: str, facts: Facts) -> list[str]:
    where = f"box {_size(facts['box_size'])} at {point(facts['box_center'])} m of the large object's frame"
    faults = [text for name, text in (("is_colliding", "in another one"), ("is_off_support", "off its support")) if facts[name]]
    stays = {None: f"whether it stays is {UNRECORDED}", True: "it would stay there", False: "it would not stay there"}[facts["is_stable"]]
    return [f"a {facts['category'].replace('_', ' ')}, {where}", "; ".join([*faults, stays])]


def _stage(key: str, facts: Facts) -> list[str]:
    head = f"{facts['stage']}: {facts['outcome']}"
    error = f"error: {facts['error']}" if facts.get("error") else ""
    rest = {k: v for k, v in facts.items() if k not in ("stage", "outcome", "error", "objects")}
    return [head, error, _listed(rest), *(_object(instance) for instance in facts.get("objects", ()))]


def _object(facts: Facts) -> str:
    who = _proposer(facts)
    return f"{facts['instance_id']} {_text(facts['category'])}: asset {facts['asset_id'][:12]} by {who}"


def _export_format(key: str, facts: Facts) -> list[str]:
    size = f"{_plural(facts['files'], 'file')}, {_bytes(facts['size_bytes'])}, {_verdict(facts)}"
    return [f"{facts['format']}: {size}", _text(facts["scene_files"]) if facts["scene_files"] else ""]


def _batch(key: str, facts: Facts) -> list[str]:
    who = f"{_plural(facts['answers'], 'answer')} by {_text(facts['annotators'])}"
    return [f"annotation batch {key}: {who}, {moment(facts['first'])} to {moment(facts['last'])}"]


def _blob(key: str, facts: Facts) -> list[str]:
    return [f"blob {key}", f"{_bytes(facts['size_bytes'])}, named by {_plural(facts['rows'], 'row')}: {_text(facts['named_by'])}"]


def _uses(key: str, facts: Facts) -> list[str]:
    counts = [_plural(facts[name], name.removesuffix("s")) for name in ("placements", "annotations")]
    return [f"{', '.join(counts)} in {_plural(facts['scenes'], 'scene')}"]


def _model(key: str, facts: Facts) -> list[str]:
    if facts["origin"] == "elsewhere":
        return [f"model {key[:12]}, which is not in this lake"]
    head = f"model {key[:12]} of {facts['kind']}, {facts['architecture']}, {_plural(facts['parameter_count'], 'number')}"
    state = "withdrawn" if facts["is_withdrawn"] else facts["origin"]
    more = f"{state} on {facts['device']}, seed {facts['seed']}, license {_text(facts['license'])}"
    return [head, more, *facts["notes"], *facts["figures"]]


def _dataset(key: str, facts: Facts) -> list[str]:
    return [f"{facts['dataset']}: {_text(facts['examples'])}", f"hash of the runs that wrote it {facts['dataset_fingerprint']}"]


def _row(key: str, facts: Facts) -> list[str]:
    return [f"row {key}"]


def _fidelity(key: str, facts: Facts) -> list[str]:
    if facts["f_5cm"] is None:
        return [f"no camera could see it; completeness {number(facts['completeness_5cm'])} at 5 cm"]
    scores = ", ".join(f"{number(facts[f'f_{at}'])} at {at[:-2]} cm" for at in ("2cm", "5cm", "10cm"))
    return [f"F-score {scores}", f"{number(100 * facts['seen_empty_share'])} % where the scan saw nothing"]


def moment(text: str | None) -> str:
    """A time to the second."""
    return UNRECORDED if text is None else f"{text[:19].replace('T', ' ')} UTC"


_WORDS: Mapping[str, Callable[[str, Facts], list[str]]] = {
    "instance": _instance, "export": _export, "export_file": _export_file, "placement": _placement, "support": _support, "moves": _moves,
    "certificate": _certificate, "episodes": _episodes, "fidelity": _fidelity, "selection": _selection, "annotation": _annotation,
    "candidate": _candidate, "model_call": _model_call, "library_model": _library_model,
    "provider": _provider, "asset": _asset, "caption": _caption, "mask": _mask, "frame": _frame, "scene": _scene, "scan": _scan,
    "stage": _stage, "export_format": _export_format, "batch": _batch, "blob": _blob, "uses": _uses, "row": _row,
    "model": _model, "dataset": _dataset, "synthesis": _synthesis, "drawing": _drawing,
}  # fmt: skip
