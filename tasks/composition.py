"""Size of a composed USD stage, counted from its layers before anything is composed.

A few small files can reference each other so often that composing them takes minutes. The count follows the same arcs, but visits
equal parts of the stage once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from schemas.budget import BUDGET
from schemas.errors import InputError

REMEDY = "flatten it, or reference fewer files"


class _Site(NamedTuple):
    """A prim path in a layer stack, which its root layer names."""

    stack: str
    path: Any


Sites = Counter[_Site]


def refuse_large_stage(path: Path) -> None:
    """Refuse a stage that would be larger than the budget once it is composed.

    Payloads count as loaded. Of variants, those count that any layer selects.

    Raises:
        InputError: too many layers, prims or arcs, or arcs that lead back to where they begin.
    """
    try:
        _Stage(path).check()
    except RecursionError as error:
        raise InputError(path.name, "arcs", f"lead through more than {BUDGET.depth} prims", REMEDY) from error


class _Stage:
    def __init__(self, path: Path) -> None:
        self._name = path.name
        self._root = str(path.absolute())
        self._stacks: dict[str, list[Any]] = {}
        self._reached: dict[_Site, Sites | None] = {}
        self._prims: dict[frozenset[tuple[_Site, int]], int | None] = {}

    def check(self) -> None:
        from pxr import Sdf

        prims = self._count(Counter({_Site(self._root, Sdf.Path.absoluteRootPath): 1}), 0)
        if prims > BUDGET.prims:
            raise self._refusal("prims", prims, BUDGET.prims)

    def _refusal(self, field: str, count: int, most: int) -> InputError:
        number = str(count) if count < 10**12 else "more than 10^12"
        return InputError(self._name, field, f"are {number} once they are composed, more than {most}", REMEDY)

    def _stack(self, root: str) -> list[Any]:
        """Layers of a stack: a root layer and its sublayers at any depth, each once."""
        if root not in self._stacks:
            layers: dict[str, Any] = {}
            self._sublayers(root, layers, {})
            self._stacks[root] = list(layers.values())
            if len(self._stacks) > BUDGET.layers:
                raise self._refusal("layers", len(self._stacks), BUDGET.layers)
        return self._stacks[root]

    def _sublayers(self, name: str, layers: dict[str, Any], occurrences: dict[str, int]) -> int:
        """Occurrences of layers below a layer, itself included: USD keeps a sublayer as often as it is named."""
        if name in occurrences:
            return occurrences[name]
        occurrences[name] = 1  # USD leaves out a sublayer that leads back to itself
        layer = _opened(name)
        if layer is None:
            return 1
        layers[layer.identifier] = layer
        below = (self._sublayers(_target(layer, each), layers, occurrences) for each in layer.subLayerPaths if each)
        occurrences[name] += sum(below)
        if occurrences[name] > BUDGET.layers:
            raise self._refusal("layers", occurrences[name], BUDGET.layers)
        return occurrences[name]

    def _specs(self, site: _Site) -> list[tuple[Any, Any]]:
        pairs = ((layer, layer.GetPrimAtPath(site.path)) for layer in self._stack(site.stack))
        return [(layer, spec) for layer, spec in pairs if spec is not None]

    def _count(self, sites: Sites, depth: int) -> int:
        """Prims at and below the prim that several sites make up together."""
        if depth > BUDGET.depth:
            raise InputError(self._name, "prims", f"are nested deeper than {BUDGET.depth}", REMEDY)
        every = self._composed(sites)
        key = frozenset(every.items())
        known = self._prims.get(key, -1)
        if known is None:
            place = min(str(site.path) for site in every)
            raise InputError(self._name, "arcs", f"lead from {place[:80]} back to it", REMEDY)
        if known >= 0:
            return known
        if len(self._prims) > BUDGET.prims:
            raise self._refusal("prims", len(self._prims), BUDGET.prims)
        self._prims[key] = None
        children: dict[str, Sites] = {}
        for site, times in every.items():
            for name in {str(child.name) for _, spec in self._specs(site) for child in spec.nameChildren}:
                children.setdefault(name, Counter())[_Site(site.stack, site.path.AppendChild(name))] += times
        total = 1 + sum(self._count(part, depth + 1) for part in children.values())
        self._prims[key] = total
        return total

    def _composed(self, sites: Sites) -> Sites:
        """All sites that a prim is composed of, as often as each is: those behind its arcs and its selected variants, too."""
        every: Sites = Counter()
        waiting, chosen = sites, set[_Site]()
        while waiting:
            for site, times in waiting.items():
                for other, number in self._behind(site).items():
                    every[other] += times * number
            if every.total() > BUDGET.arcs:
                raise self._refusal("arcs", every.total(), BUDGET.arcs)
            selected = Counter(dict(self._variants(every)))
            waiting = Counter({site: times for site, times in selected.items() if site not in chosen})
            chosen |= set(waiting)
        return every

    def _variants(self, every: Sites) -> Iterator[tuple[_Site, int]]:
        specs = [(site, spec) for site in every if not site.path.IsAbsoluteRootPath() for _, spec in self._specs(site)]
        selections = {(str(name), str(value)) for _, spec in specs for name, value in dict(spec.variantSelections).items()}
        for site, spec in specs:
            for name, variants in spec.variantSets.items():
                for value in {value for of, value in selections if of == name} & {str(each.name) for each in variants.variantList}:
                    yield _Site(site.stack, site.path.AppendVariantSelection(name, value)), every[site]

    def _behind(self, site: _Site) -> Sites:
        """A site and those that its arcs lead to, at any depth."""
        known = self._reached.get(site, Counter())
        if known is None:
            raise InputError(self._name, "arcs", f"lead from {str(site.path)[:80]} back to it", REMEDY)
        if known:
            return known
        self._reached[site] = None
        reached: Sites = Counter({site: 1})
        for target, times in Counter(self._arcs_of(site)).items():
            for other, number in self._behind(target).items():
                reached[other] += times * number
            if reached.total() > BUDGET.arcs:
                raise self._refusal("arcs", reached.total(), BUDGET.arcs)
        self._reached[site] = reached
        return reached

    def _arcs_of(self, site: _Site) -> Iterator[_Site]:
        for layer, spec in self._specs(site):
            for field in ("references", "payload"):
                for arc in _items(spec, field):
                    stack = _target(layer, arc.assetPath) if arc.assetPath else site.stack
                    path = arc.primPath or self._default_prim(stack)
                    if path:
                        yield _Site(stack, path)
            for field in ("inheritPaths", "specializes"):
                for path in _items(spec, field):
                    # A class is also looked up in the stage's own layers, which may add to it.
                    for stack in {site.stack, self._root}:
                        target = _Site(stack, path)
                        if target != site and self._specs(target):
                            yield target

    def _default_prim(self, stack: str) -> Any:
        from pxr import Sdf

        layer = next(iter(self._stack(stack)), None)
        name = layer.defaultPrim if layer is not None else ""
        return Sdf.Path(name if name.startswith("/") else f"/{name}") if name else None


def _opened(name: str) -> Any:
    """A layer; None if it is missing or broken, which composing reports."""
    from pxr import Sdf, Tf

    try:
        return Sdf.Layer.FindOrOpen(name)
    except Tf.ErrorException:
        return None


def _items(spec: Any, field: str) -> list[Any]:
    """Items that a list of arcs adds; list operations may name one as often as they like."""
    if not spec.HasInfo(field):
        return []
    items: list[Any] = spec.GetInfo(field).GetAddedOrExplicitItems()
    return items


def _target(layer: Any, asset: str) -> str:
    """Identifier of a layer that another one names."""
    from pxr import Sdf

    return str(Sdf.ComputeAssetPathRelativeToLayer(layer, asset))
