"""Boxes by networks of random weights, as the library's own processors have them, and by programs that behave, fail and lie."""

from __future__ import annotations

import dataclasses
import json
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.capture.small_objects.detectors import CommandedDetector, Detections, GroundingDino, Owlv2, RfDetr, detector_in
from tasks.capture.small_objects.detectors.commanded import answer_of
from tasks.capture.small_objects.detectors.detector import DetectionSelection, box_overlap, phrases, selected
from tasks.capture.small_objects.detectors.grounding_dino import written
from tests.tasks.calls.hanging import assert_all_end

PICTURES = [np.random.default_rng(i).integers(0, 256, (h, w, 3), dtype=np.uint8) for i, (h, w) in enumerate([(60, 90), (75, 50), (60, 90)])]
NAMES = ("Red mug!", "book", "coffee table", "pen")

OPEN: dict[str, Any] = {
    "grounding_dino": GroundingDino(threshold=0.0, text_threshold=0.0, shortest_px=64, longest_px=96, same_box=1.0, device="cpu"),
    "owlv2": Owlv2(threshold=0.0, same_box=1.0, device="cpu"),
    "rf_detr": RfDetr(threshold=0.0, side_px=64, same_box=1.0, skipped=("person",), device="cpu"),
}
"""Settings by which everything counts."""


def found(name: str, networks: Path, **more: Any) -> list[Detections]:
    settings = dataclasses.replace(OPEN[name], weights=str(networks / name), **more)
    return detector_in(settings).detect(PICTURES, NAMES)


def close(first: list[Detections], second: list[Detections]) -> bool:
    return all(
        a.labels == b.labels and np.allclose(a.boxes, b.boxes, atol=0.01) and np.allclose(a.scores, b.scores, atol=1e-5)
        for a, b in zip(first, second, strict=True)
    )


@pytest.mark.whole
@pytest.mark.parametrize("name", OPEN)
def test_what_is_found_has_names_that_were_asked_for_whatever_the_batch(name: str, networks: Path) -> None:
    answers = found(name, networks)
    known = NAMES if name != "rf_detr" else ("cup", "book", "chair", "mouse")
    for answer, picture in zip(answers, PICTURES, strict=True):
        height, width = picture.shape[:2]
        assert len(answer.labels) > 1
        assert set(answer.labels) <= set(known)
        assert (answer.boxes >= 0).all()
        assert (answer.boxes <= [width, height, width, height]).all()
        assert (np.diff(answer.scores) <= 0).all(), "the surest first"
        assert (answer.masks is None) == (name != "rf_detr")
        assert answer.masks is None or answer.masks.shape == (len(answer.labels), height, width)
    assert close(answers, found(name, networks, batch=1))
    assert [answer.boxes.tobytes() for answer in found(name, networks)] == [answer.boxes.tobytes() for answer in answers]
    most = found(name, networks, most=2)
    assert close(most, [answer.at([0, 1]) for answer in answers])


@pytest.mark.whole
def test_rf_detr_skips_classes_and_draws_what_the_library_draws(networks: Path) -> None:
    """Its own way from logits to masks, written again here: the best class of each query, and masks at the picture's size."""
    import torch
    from transformers import RfDetrForInstanceSegmentation

    from tasks.capture.small_objects.detectors.rf_detr import in_side

    answer = found("rf_detr", networks)[1]
    network: Any = RfDetrForInstanceSegmentation.from_pretrained(str(networks / "rf_detr")).eval()
    with torch.no_grad():
        out = network(pixel_values=torch.from_numpy(in_side(PICTURES[1], 64))[None])
    sure = out.logits[0].sigmoid()[:, 1:]  # without the person
    order = sure.max(dim=1).values.argsort(descending=True)
    masks = torch.nn.functional.interpolate(out.pred_masks[0][:, None], (75, 50), mode="bilinear", align_corners=False)[:, 0] > 0
    drawn = [i for i in order.tolist() if (out.pred_boxes[0, i, 2:] * torch.tensor([50, 75]) >= 2.1).all()]
    assert len(drawn) >= len(answer.labels) - 1 > 2
    for place in range(min(len(answer.labels), len(drawn))):
        same = [i for i in drawn if np.isclose(float(sure[i].max()), answer.scores[place], atol=1e-6)]
        assert any(np.array_equal(masks[i].numpy(), answer.masks[place]) for i in same)  # type: ignore[index]
    none = found("rf_detr", networks, threshold=1.0)[0]
    assert none.masks is not None
    assert none.masks.shape == (0, 60, 90)


@pytest.mark.whole
def test_grounding_dino_is_as_its_processor_has_it(networks: Path) -> None:
    import torch
    from transformers import AutoTokenizer, GroundingDinoForObjectDetection, GroundingDinoProcessor
    from transformers.models.grounding_dino.image_processing_pil_grounding_dino import GroundingDinoImageProcessorPil

    tokenizer = AutoTokenizer.from_pretrained(str(networks / "grounding_dino"))
    processor: Any = GroundingDinoProcessor(GroundingDinoImageProcessorPil(size={"shortest_edge": 64, "longest_edge": 96}), tokenizer)
    network: Any = GroundingDinoForObjectDetection.from_pretrained(str(networks / "grounding_dino")).eval()
    answer = found("grounding_dino", networks, threshold=0.3, text_threshold=0.3)[0]
    inputs = processor(images=PICTURES[0], text=[list(phrases(NAMES))], return_tensors="pt")
    assert inputs["input_ids"].tolist() == tokenizer([written(list(phrases(NAMES)))[0]])["input_ids"]
    with torch.no_grad():
        (theirs,) = processor.post_process_grounded_object_detection(
            network(**inputs), inputs["input_ids"], threshold=0.3, text_threshold=0.3, target_sizes=[(60, 90)]
        )
    order = theirs["scores"].argsort(descending=True)
    boxes = np.clip(theirs["boxes"][order].numpy(), 0, [90, 60, 90, 60])
    large = ((boxes[:, 2:] - boxes[:, :2]) >= 2).all(axis=1)
    assert np.allclose(answer.boxes, boxes[large], atol=0.01)
    assert np.allclose(answer.scores, theirs["scores"][order].numpy()[large], atol=1e-5)
    for label, theirs_label in zip(answer.labels, np.array(theirs["text_labels"])[order.numpy()][large], strict=True):
        words = {word.strip(".") for word in theirs_label.split()}
        assert words & set(next(p for p, n in phrases(NAMES).items() if n == label).split()), "a token that is sure is of the phrase"


@pytest.mark.whole
def test_owlv2_is_as_its_processor_has_it(networks: Path) -> None:
    import torch
    from transformers import CLIPTokenizer, Owlv2ForObjectDetection, Owlv2Processor
    from transformers.models.owlv2.image_processing_pil_owlv2 import Owlv2ImageProcessorPil

    processor: Any = Owlv2Processor(
        Owlv2ImageProcessorPil(size={"height": 64, "width": 64}), CLIPTokenizer.from_pretrained(str(networks / "owlv2"))
    )
    network: Any = Owlv2ForObjectDetection.from_pretrained(str(networks / "owlv2")).eval()
    answer = found("owlv2", networks, threshold=0.05)[0]
    texts = [f"a photo of a {phrase}" for phrase in phrases(NAMES)]
    inputs = processor(images=PICTURES[0], text=[texts], return_tensors="pt")
    with torch.no_grad():
        (theirs,) = processor.post_process_grounded_object_detection(
            network(**inputs), threshold=0.05, target_sizes=[(60, 90)], text_labels=[list(NAMES)]
        )
    order = theirs["scores"].argsort(descending=True)
    boxes = np.clip(theirs["boxes"][order].numpy(), 0, [90, 60, 90, 60])
    large = ((boxes[:, 2:] - boxes[:, :2]) >= 2).all(axis=1)
    assert len(answer.labels) == large.sum() > 2
    assert np.allclose(answer.boxes, boxes[large], atol=0.02)
    assert np.allclose(answer.scores, theirs["scores"][order].numpy()[large], atol=1e-4)
    assert list(answer.labels) == np.array(theirs["text_labels"])[order.numpy()][large].tolist()


@pytest.mark.whole
def test_names_are_asked_for_some_at_a_time_and_too_many_for_the_network_are_asked_for_in_parts(networks: Path) -> None:
    few = found("owlv2", networks, names_per_call=1)
    assert {label for answer in few for label in answer.labels} == set(NAMES), "each alone is the surest of its call"
    settings = dataclasses.replace(OPEN["grounding_dino"], weights=str(networks / "grounding_dino"))
    many = [f"mug {'red ' * i}".strip() for i in range(1, 9)]  # 36 words and 8 periods, and all of them again
    asked = [*many, *(f"pen {'red ' * i}".strip() for i in range(1, 9))]
    whole = detector_in(dataclasses.replace(settings, names_per_call=80)).detect(PICTURES, asked)
    halves = detector_in(dataclasses.replace(settings, names_per_call=8)).detect(PICTURES, asked)
    assert close(whole, halves)
    assert len(whole[0].labels) > 1
    with pytest.raises(InputError, match="more than 64 tokens"):
        detector_in(settings).detect(PICTURES[:1], [f"mug {'red ' * 70}"])


@given(st.lists(st.text(max_size=12), max_size=8))
def test_phrases_are_plain_words_that_lead_back_to_names(names: list[str]) -> None:
    asked = phrases(names)
    assert all(phrase and phrase == phrase.strip() and "." not in phrase and "  " not in phrase for phrase in asked)
    assert set(asked.values()) <= set(names)
    text, spans = written(list(asked))
    assert [text[a:b] for a, b in spans] == list(asked)


@given(st.integers(0, 500), st.integers(0, 30), st.floats(0.1, 1.0))
def test_of_boxes_that_cover_each_other_the_surest_stays(seed: int, count: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-10, 60, (count, 2))
    boxes = np.concatenate([low, low + rng.uniform(0, 40, (count, 2))], axis=1)
    answer = Detections(boxes, tuple(str(i) for i in range(count)), rng.uniform(size=count))
    kept = selected(answer, DetectionSelection(same_box=share, most=12), 64, 64)
    assert len(kept.labels) <= 12
    assert (np.diff(kept.scores) <= 0).all()
    overlaps = [box_overlap(a, b) for i, a in enumerate(kept.boxes) for b in kept.boxes[:i]]
    assert max(overlaps, default=0) <= share
    clipped = np.clip(boxes, 0, 64)
    if len(kept.labels) < 12:
        for i in range(count):
            if ((clipped[i, 2:] - clipped[i, :2]) >= 2).all() and str(i) not in kept.labels:
                surer = [b for b, s in zip(kept.boxes, kept.scores, strict=True) if s >= answer.scores[i]]
                assert any(box_overlap(clipped[i], b) > share for b in surer)


def runs(mask: np.ndarray) -> dict[str, Any]:
    """A mask as COCO has it: column by column, one run after another, the first outside."""
    counts, inside, length = [], False, 0
    for value in mask.T.ravel().tolist():
        if value != inside:
            counts.append(length)
            inside, length = value, 0
        length += 1
    return {"size": list(mask.shape), "counts": [*counts, length]}


@given(st.integers(0, 10**6))
def test_masks_come_through_run_lengths_as_they_were(seed: int) -> None:
    rng = np.random.default_rng(seed)
    masks = rng.random((int(rng.integers(0, 4)), *rng.integers(1, 9, 2))) < rng.random()
    height, width = masks.shape[1:]
    table = {"boxes": [[0, 0, 1, 1]] * len(masks), "labels": ["mug"] * len(masks), "scores": [0.5] * len(masks)}
    answer = answer_of(json.dumps({**table, "masks": [runs(mask) for mask in masks]}).encode(), height, width)
    assert answer.masks is not None
    assert np.array_equal(answer.masks, masks)


GOOD: dict[str, Any] = {"boxes": [[1, 2, 30, 40.5]], "labels": ["mug"], "scores": [0.9]}
BAD = {
    "content: is no JSON": b"{", "content: is no table": b"[]", "boxes: must be a list": {**GOOD, "boxes": None},
    "boxes: must be four numbers": {**GOOD, "boxes": [[1, 2, 3]]}, "boxes: must be x0": {**GOOD, "boxes": [[30, 2, 1, 40]]},
    "boxes: must be as many": {**GOOD, "labels": ["mug", "cup"]}, "boxes: must be finite": {**GOOD, "boxes": [[0, 0, 1e9, 3]]},
    "labels: must be texts": {**GOOD, "labels": [3]}, "scores: must be 0 to 1": {**GOOD, "scores": [-0.1]},
    "scores: must be finite": {**GOOD, "scores": [float("nan")]}, "scores: must be numbers": {**GOOD, "scores": [True]},
    "masks: must be a list": {**GOOD, "masks": 1}, "size must be [60, 90]": {**GOOD, "masks": [{"size": [9, 9], "counts": [81]}]},
    "packed into a text": {**GOOD, "masks": [{"size": [60, 90], "counts": "PPYo0"}]},
    "must sum up to 5400": {**GOOD, "masks": [{"size": [60, 90], "counts": [1, 2]}]},
    "counts must be a list": {**GOOD, "masks": [{"size": [60, 90], "counts": [5401, -1]}]},
}  # fmt: skip


@pytest.mark.parametrize("said", BAD)
def test_answers_that_cannot_be_are_refused_by_their_field(said: str) -> None:
    data = BAD[said]
    with pytest.raises(InputError, match=r"found\.json") as refused:
        answer_of(data if isinstance(data, bytes) else json.dumps(data).encode(), 60, 90)
    assert said in str(refused.value)


def program(folder: Path, body: str, words: str = '{image} "{names}" {out}', **more: Any) -> CommandedDetector:
    path = folder / "tool.py"
    path.write_text("import json, os, pathlib, sys, time\nimage, names, out = [*sys.argv[1:], ''][:3]\n" + textwrap.dedent(body))
    return CommandedDetector(command=f'"{sys.executable}" {path} {words}', model="yolo", **more)


def test_a_program_is_given_picture_names_and_place(tmp_path: Path) -> None:
    body = f"""
    assert pathlib.Path(image).read_bytes()[:4] == b"\\x89PNG"
    assert names == "red mug, book", names
    json.dump({{**{GOOD!r}, "boxes": [[1, 2, 300, 40.5]]}}, open(out, "w"))
    """
    detector = detector_in(program(tmp_path, body))
    assert (detector.name, detector.is_open, detector.draws_masks, detector.placement) == ("command:yolo", True, False, None)
    (answer,) = detector.detect(PICTURES[:1], ["red mug", "book"])
    assert answer.boxes.tolist() == [[1, 2, 90, 40.5]], "cut at the picture's border"
    assert (answer.labels, answer.scores.tolist(), answer.masks) == (("mug",), [0.9], None)


def test_a_program_with_names_of_its_own_is_a_closed_set_and_may_draw(tmp_path: Path) -> None:
    mask = np.zeros((60, 90), dtype=bool)
    mask[10:20, 30:50] = True
    table = {"boxes": [[30, 10, 50, 20], [0, 0, 9, 9]], "labels": ["cup", "cup"], "scores": [0.6, 0.1], "masks": [runs(mask), runs(~mask)]}
    (tmp_path / "answer.json").write_text(json.dumps(table))
    body = f"import shutil; shutil.copy({str(tmp_path / 'answer.json')!r}, sys.argv[2])"
    detector = detector_in(program(tmp_path, body, "{image} {out}", draws_masks=True))
    assert (detector.is_open, detector.draws_masks) == (False, True)
    (answer,) = detector.detect(PICTURES[:1], [])
    assert answer.masks is not None
    assert np.array_equal(answer.masks, mask[None])
    del table["masks"]
    (tmp_path / "answer.json").write_text(json.dumps(table))
    with pytest.raises(InputError, match="masks: are not there"):
        detector.detect(PICTURES[:1], [])


FAILING = {
    "raise ValueError('no card')": "ended with code 1: ValueError: no card",
    "pass": "cannot be read",
    "os.mkfifo(out)": "is a pipe",
    "os.symlink('/etc/passwd', out)": "is no JSON",
}


@pytest.mark.parametrize(("body", "said"), FAILING.items())
def test_a_program_that_does_not_do_its_work_is_told(tmp_path: Path, body: str, said: str) -> None:
    with pytest.raises(InputError) as told:
        detector_in(program(tmp_path, body)).detect(PICTURES[:1], ["mug"])
    assert said in str(told.value)


@pytest.mark.whole
def test_a_program_that_hangs_is_ended_with_all_that_it_began(tmp_path: Path) -> None:
    def end(body: str, seconds: float) -> None:
        with pytest.raises(InputError, match=f"took longer than {seconds:.0f} s"):
            detector_in(program(tmp_path, body, timeout_seconds=seconds)).detect(PICTURES[:1], ["mug"])

    assert_all_end(tmp_path, end)


@pytest.mark.parametrize("command", ["", "yolo {picture}", "yolo {image", 'yolo "{image}'])
def test_command_lines_that_mean_nothing_are_refused(command: str) -> None:
    with pytest.raises(InputError, match=r"capture\.small_objects\.provider\.detector: command"):
        detector_in(CommandedDetector(command=command))


def test_detections_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="must be as many"):
        Detections(np.zeros((2, 4)), ("mug",), np.zeros(2))
