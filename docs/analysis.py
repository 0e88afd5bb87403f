"""Ten questions of the statistics, asked of any lake; a marimo notebook.

    METASCENES_LAKE=lake marimo edit docs/analysis.py

opens it, and ``METASCENES_LAKE=lake python docs/analysis.py`` runs it as a script.
"""

import marimo

app = marimo.App(width="medium")


@app.cell
def _():
    import os

    import marimo as mo
    import matplotlib.pyplot as plt
    import numpy as np

    from warehouse.lake import Lake
    from warehouse.questions.sql import read_only

    return Lake, mo, np, os, plt, read_only


@app.cell
def _(Lake, mo, os, read_only):
    # The door: the newest snapshot of a lake, or an older one by its number. `ask` gives columns by name.
    lake = Lake.open(os.environ.get("METASCENES_LAKE", "lake"))
    reader = lake.snapshot()
    connection = reader.connect()  # a DuckDB connection with a view per table and per question

    def ask(sql):
        """The columns of an answer, as lists."""
        read_only(sql)
        return connection.sql(sql).to_arrow_table().to_pydict()

    headline = {name: values[0] for name, values in ask("FROM headline").items()}
    mo.md(
        f"""
        # What is in {lake.address}?

        Snapshot {reader.snapshot_id}: **{headline["scenes"]:,} scenes** of {headline["rooms"]:,} rooms,
        **{headline["objects"]:,} objects** in {headline["categories"]:,} categories, {headline["assets"]:,} assets.

        Every question below is a view or a line of SQL; `metascenes sql --list` names the views, and
        `DESCRIBE <view>` their columns.
        """
    )
    return ask, connection, headline, lake, reader


@app.cell
def _(np, plt):
    def whole_bins(counts):
        """Edges of at most 30 bins, each with as many whole numbers as any other."""
        low, high = (min(counts), max(counts)) if len(counts) else (0, 0)
        width = (high - low) // 30 + 1
        return np.arange(low, high + width + 1, width) - 0.5

    def chart(title, across, up, *, wide=7.0, high=3.2):
        """An empty chart with its title and what its axes show."""
        figure, axes = plt.subplots(figsize=(wide, high), layout="constrained")
        axes.set(title=title, xlabel=across, ylabel=up)
        axes.spines[["top", "right"]].set_visible(False)
        return figure, axes

    BLUE, ORANGE, GRAY = "#3b6ea5", "#d98032", "#9aa3ad"
    return BLUE, GRAY, ORANGE, chart, whole_bins


@app.cell
def _(BLUE, ask, chart, np, whole_bins):
    # 1. How many objects does a scene hold? (Fig. A6)
    objects = ask("SELECT scene_id, objects FROM objects_per_scene ORDER BY scene_id")
    _counts = np.array(objects["objects"])
    _figure, _axes = chart("How many objects does a scene hold?", "objects", "scenes")
    _axes.hist(_counts, bins=whole_bins(_counts), color=BLUE, edgecolor="white")
    if len(_counts):
        _axes.axvline(_counts.mean(), color="black", linewidth=1)
        _axes.annotate(f" mean {_counts.mean():.1f}", (_counts.mean(), _axes.get_ylim()[1]), va="top")
    _figure
    return (objects,)


@app.cell
def _(BLUE, ask, chart, np, whole_bins):
    # 2. How many categories does a scene hold? (Fig. A6)
    categories = ask("SELECT scene_id, categories FROM categories_per_scene ORDER BY scene_id")
    _counts = np.array(categories["categories"])
    _figure, _axes = chart("How many categories does a scene hold?", "categories", "scenes")
    _axes.hist(_counts, bins=whole_bins(_counts), color=BLUE, edgecolor="white")
    _figure
    return (categories,)


@app.cell
def _(BLUE, ask, chart):
    # 3. Which categories are most frequent?
    frequent = ask("SELECT category, objects, scenes, share FROM category_counts ORDER BY objects DESC, category LIMIT 20")
    _figure, _axes = chart("Which categories are most frequent?", "objects", "", high=4.5)
    _axes.barh(frequent["category"][::-1], frequent["objects"][::-1], color=BLUE)
    _figure
    return (frequent,)


@app.cell
def _(BLUE, ask, chart):
    # 4. How large are the objects of a category? (Fig. A7) Boxes are quartiles; whiskers reach 1.5 times their distance.
    volumes = ask(
        "SELECT category, objects, whisker_low_m3, q1_m3, median_m3, q3_m3, whisker_high_m3 FROM volume_by_category"
        " ORDER BY frequency_rank LIMIT 20"
    )
    _names = ("med", "q1", "q3", "whislo", "whishi")
    _columns = (volumes[f"{name}_m3"] for name in ("median", "q1", "q3", "whisker_low", "whisker_high"))
    _boxes = [dict(zip(_names, values, strict=True)) for values in zip(*_columns, strict=True)]
    _figure, _axes = chart("How large are the objects of a category?", "", "volume of the box [m3]", high=4.0)
    if _boxes:
        _axes.bxp(_boxes, showfliers=False, patch_artist=True, boxprops={"facecolor": BLUE}, medianprops={"color": "black"})
    _axes.set_xticks(range(1, len(_boxes) + 1), volumes["category"], rotation=60, ha="right")
    _axes.set_yscale("log")
    _figure
    return (volumes,)


@app.cell
def _(ask, chart, np):
    # 5. Which categories stand in which rooms?
    standing = ask(
        "SELECT room_type, category, objects FROM category_by_room_type"
        " WHERE category IN (SELECT category FROM category_counts ORDER BY objects DESC, category LIMIT 15) ORDER BY ALL"
    )
    _rooms, _categories = sorted(set(standing["room_type"])), sorted(set(standing["category"]))
    rooms_by_category = np.zeros((len(_rooms), len(_categories)), int)
    for _room, _category, _count in zip(*standing.values(), strict=True):
        rooms_by_category[_rooms.index(_room), _categories.index(_category)] = _count
    _figure, _axes = chart("Which categories stand in which rooms?", "", "", high=3.0)
    if rooms_by_category.size:
        _image = _axes.imshow(np.log1p(rooms_by_category), cmap="Blues", aspect="auto")
        _axes.set_xticks(range(len(_categories)), _categories, rotation=60, ha="right")
        _axes.set_yticks(range(len(_rooms)), _rooms)
        for (_row, _column), _count in np.ndenumerate(rooms_by_category):
            if _count:
                _color = "white" if np.log1p(_count) > _image.norm.vmax * 0.6 else "black"
                _axes.text(_column, _row, str(_count), ha="center", va="center", fontsize=7, color=_color)
    _figure
    return rooms_by_category, standing


@app.cell
def _(BLUE, GRAY, ask, chart, np):
    # 6. How long does each stage take a scene?
    timing = ask("SELECT stage, median_seconds, p95_seconds, seconds_per_object FROM stage_timing ORDER BY total_seconds")
    _at = np.arange(len(timing["stage"]))
    _figure, _axes = chart("How long does each stage take a scene?", "seconds", "")
    _axes.barh(_at + 0.2, timing["median_seconds"], 0.4, color=BLUE, label="median")
    _axes.barh(_at - 0.2, timing["p95_seconds"], 0.4, color=GRAY, label="95th percentile")
    _axes.set_yticks(_at, timing["stage"])
    _axes.legend(frameon=False, loc="lower right")
    _figure
    return (timing,)


@app.cell
def _(ask, chart, np):
    # 7. Whose candidates win, and from which slot?
    wins = ask("SELECT provider, slot, wins FROM candidate_wins ORDER BY provider, slot")
    _slots = sorted(set(wins["slot"]))
    _below = np.zeros(len(_slots))
    _figure, _axes = chart("Whose candidates win, and from which slot?", "slot", "objects")
    for _index, _provider in enumerate(sorted(set(wins["provider"]))):
        _rows = zip(*wins.values(), strict=True)
        _counts = {slot: count for provider, slot, count in _rows if provider == _provider}
        _heights = np.array([_counts.get(slot, 0) for slot in _slots])
        _axes.bar(_slots, _heights, bottom=_below, label=_provider, color=f"C{_index}")
        _below += _heights
    if _slots:
        _axes.set_xticks(_slots)
        _axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    _figure
    return (wins,)


@app.cell
def _(BLUE, GRAY, ask, chart):
    # 8. How many pairs of objects are deep in each other, before and after the optimization?
    collisions = ask(
        "SELECT count(*) AS scenes, coalesce(sum(deep_pairs_before), 0)::BIGINT AS before,"
        " coalesce(sum(deep_pairs_after), 0)::BIGINT AS after FROM collision_loss"
    )
    _figure, _axes = chart("How many pairs are deeper than 2 mm in each other?", "", "pairs", wide=5.0)
    _bars = _axes.bar(["before", "after"], [collisions["before"][0], collisions["after"][0]], color=[GRAY, BLUE])
    _axes.bar_label(_bars)
    _figure
    return (collisions,)


@app.cell
def _(BLUE, ORANGE, ask, chart):
    # 9. What share of the free objects stays where it was put, left alone under gravity?
    stable = ask(
        "SELECT engine, sum(free)::BIGINT AS free, sum(stable_1cm) / nullif(sum(free), 0) AS within_1cm,"
        " sum(stable_5cm) / nullif(sum(free), 0) AS within_5cm FROM stability GROUP BY engine ORDER BY engine"
    )
    _figure, _axes = chart("What share of the free objects stays where it was put?", "", "share", wide=5.0)
    for _index, (_engine, _free, _one, _five) in enumerate(zip(*stable.values(), strict=True)):
        _axes.bar([_index - 0.2, _index + 0.2], [_one or 0, _five or 0], 0.38, color=[ORANGE, BLUE])
    _axes.set_xticks(range(len(stable["engine"])), [f"{engine}\n(1 cm, 5 cm)" for engine in stable["engine"]])
    _axes.set_ylim(0, 1.05)
    _figure
    return (stable,)


@app.cell
def _(BLUE, ask, chart):
    # 10. What share of a scene's floor can an agent reach?
    reach = ask("SELECT scene_id, agent, navigable_share, episodes FROM navigability ORDER BY scene_id, agent")
    _shares = [share for share in reach["navigable_share"] if share is not None]
    _figure, _axes = chart("What share of a scene's floor can an agent reach?", "share of the floor", "scenes")
    # beyond 1 where a navmesh has storeys and the floor is one
    _axes.hist(_shares, bins=20, range=(0, max([1, *_shares])), color=BLUE, edgecolor="white")
    _figure
    return (reach,)


@app.cell
def _(ask, chart):
    # 11. How large are the rooms of each kind, and how full?
    parted = ask("SELECT scene_id, room_index, room_type, floor_area_m2, objects FROM room_overview ORDER BY scene_id, room_index")
    _figure, _axes = chart("How large are the rooms of each kind, and how full?", "floor [m2]", "objects")
    for _kind in sorted(set(parted["room_type"])):
        _own = [index for index, kind in enumerate(parted["room_type"]) if kind == _kind]
        _axes.plot(*([parted[name][index] for index in _own] for name in ("floor_area_m2", "objects")), "o", alpha=0.7, label=_kind)
    if parted["room_type"]:
        _axes.legend(frameon=False, fontsize=7)
    _figure
    return (parted,)


@app.cell
def _(mo):
    mo.md(
        """
        ## Further

        * Another snapshot or release: `lake.snapshot(3)`; `metascenes release list` names releases.
        * The whole of DuckDB, with data frames: `connection.sql("...").df()`.
        * Other tools: `docs/clients.md`. What the columns mean: `docs/tables.md`.
        """
    )
    return


if __name__ == "__main__":
    _, found = app.run()
    print(found["headline"])
