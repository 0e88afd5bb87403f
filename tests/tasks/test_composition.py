"""USD files that grow when they are composed: refused from their layers, before anything is composed."""

from __future__ import annotations

from pathlib import Path

import pytest

from schemas.errors import InputError
from tasks.composition import refuse_large_stage
from tasks.exports.usd.rules import check_usd
from tasks.library.formats import read_model
from tests.tasks.library.models import as_usdz

HEAD = '#usda 1.0\n(\ndefaultPrim = "r"\nmetersPerUnit = 1\nupAxis = "Z"\n{0})\n'
TRIANGLE = """def Mesh "m"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
}"""
FILE_ARCS = {
    "references": "prepend references = @./l{0}.usda@",
    "payloads": "prepend payload = @./l{0}.usda@",
    "instances": "instanceable = true\nprepend references = @./l{0}.usda@",
}
INNER_ARCS = {
    "internal references": "prepend references = </k{0}>",
    "inherits": "prepend inherits = </k{0}>",
    "specializes": "prepend specializes = </k{0}>",
}


def prim(name: str, arcs: str = "", content: str = "", kind: str = "def Xform") -> str:
    return f'{kind} "{name}" (\n{arcs}\n)\n{{\n{content}\n}}\n'


def fourfold(arc: str) -> str:
    return "".join(prim(f"c{number}", arc) for number in range(4))


def chained(shape: str, levels: int) -> dict[str, str]:
    """Files of a stage, `l0.usda` first, in which every level draws four times on the next."""
    files = {}
    for level in range(levels + 1):
        below = level + 1
        is_last = level == levels
        head = HEAD.format("")
        if shape in FILE_ARCS:
            text = head + prim("r", content=TRIANGLE if is_last else fourfold(FILE_ARCS[shape].format(below)))
        else:
            named = ", ".join(f"@./l{below}.usda@ (offset = {number + 1})" for number in range(4))
            if shape == "sublayers":
                head = HEAD.format("" if is_last else f"subLayers = [{named}]\n")
            arcs = f"prepend references = [{named}]" if shape == "arcs of one prim" and not is_last else ""
            text = head + prim("r", arcs, TRIANGLE if is_last else "")
        files[f"l{level}.usda"] = text
    return files


def nested(shape: str, levels: int) -> dict[str, str]:
    """One file, whose classes draw four times on the next."""
    text = HEAD.format("")
    for level in range(levels + 1):
        is_last = level == levels
        if shape == "variants":
            content = TRIANGLE if is_last else fourfold(f"prepend references = </k{level + 1}>")
            arcs = 'variants = {\nstring s = "a"\n}\nprepend variantSets = "s"'
            content = f'variantSet "s" = {{\n"a" {{\n{content}\n}}\n}}'
        else:
            arcs, content = "", TRIANGLE if is_last else fourfold(INNER_ARCS[shape].format(level + 1))
        text += prim(f"k{level}", arcs, content, "class Xform")
    arc = INNER_ARCS.get(shape, INNER_ARCS["internal references"]).format(0)
    return {"l0.usda": text + prim("r", arc)}


def written(folder: Path, files: dict[str, str]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder / "l0.usda"


CHAINED = (*FILE_ARCS, "sublayers", "arcs of one prim")
NESTED = (*INNER_ARCS, "variants")


@pytest.mark.parametrize("shape", [*CHAINED, *NESTED])
def test_what_grows_fourfold_over_ten_levels_is_refused_before_it_is_composed(tmp_path: Path, shape: str) -> None:
    make = chained if shape in CHAINED else nested
    with pytest.raises(InputError, match=r"^l0\.usda: (prims|arcs|layers): are \d+ once they are composed, more than \d+; flatten it"):
        refuse_large_stage(written(tmp_path / "large", make(shape, 10)))
    refuse_large_stage(written(tmp_path / "small", make(shape, 3)))


@pytest.mark.whole
def test_a_library_and_doctor_refuse_it_in_one_line_and_so_in_a_package(tmp_path: Path) -> None:
    files = chained("references", 10)
    path = written(tmp_path, files)
    problem = "prims: are 2446678 once they are composed, more than 131072; flatten it, or reference fewer files"
    package = tmp_path / "packed.usdz"
    package.write_bytes(as_usdz({name: text.encode() for name, text in files.items()}))
    for file in (path, package):
        with pytest.raises(InputError) as refused:
            read_model(file, tmp_path)
        assert problem in str(refused.value)
        (finding,) = [finding for finding in check_usd(file) if finding.rule == "budget"]
        assert problem in finding.message


@pytest.mark.parametrize(
    "text",
    [
        prim("r", "prepend references = </r>"),
        prim("r", content=prim("a", "prepend references = </r>")),
        prim("r", "prepend references = </s>") + prim("s", "prepend inherits = </r>"),
        prim("r", "prepend payload = @./l0.usda@"),
    ],
)
def test_arcs_that_lead_back_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"^l0\.usda: arcs: lead from /\S* back to it"):
        refuse_large_stage(written(tmp_path, {"l0.usda": HEAD.format("") + text}))


def test_chains_of_thousands_of_arcs_and_deep_prims_are_refused(tmp_path: Path) -> None:
    chain = "".join(prim(f"p{number}", f"prepend references = </p{number + 1}>") for number in range(3000))
    with pytest.raises(InputError, match="lead through more than"):
        refuse_large_stage(written(tmp_path, {"l0.usda": HEAD.format("") + chain}))
    deep = HEAD.format("") + 'def Xform "a"\n{\n' * 300 + "}\n" * 300
    with pytest.raises(InputError, match="are nested deeper than 256"):
        refuse_large_stage(written(tmp_path, {"l0.usda": deep}))


def test_what_is_missing_or_broken_is_left_to_usd(tmp_path: Path) -> None:
    (tmp_path / "broken.usda").write_text("no layer")
    arcs = "prepend references = [@./missing.usda@, @./broken.usda@, </gone>]"
    assert refuse_large_stage(written(tmp_path, {"l0.usda": HEAD.format("") + prim("r", arcs)})) is None
    assert refuse_large_stage(tmp_path / "missing.usda") is None
