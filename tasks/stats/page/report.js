(function () {
  "use strict";
  const root = document.documentElement;
  root.classList.add("js");

  // Scan and replica: beside each other, or one over the other.
  const cards = document.getElementById("cards");
  const beside = document.getElementById("beside"), slider = document.getElementById("slider");
  function show(slide) {
    cards.classList.toggle("slide", slide);
    slider.setAttribute("aria-pressed", String(slide));
    beside.setAttribute("aria-pressed", String(!slide));
  }
  if (beside) {
    beside.addEventListener("click", () => show(false));
    slider.addEventListener("click", () => show(true));
  }
  if (cards) {
    cards.addEventListener("input", event => {
      const pair = event.target.closest(".pair");
      if (pair) { pair.style.setProperty("--cut", event.target.value + "%"); }
    });
  }

  // A link to the SQL of a view unfolds it.
  function unfold() {
    const found = location.hash && document.getElementById(location.hash.slice(1));
    if (found && found.tagName === "DETAILS") { found.open = true; }
  }
  window.addEventListener("hashchange", unfold);
  unfold();

  // The bar of sections says where one is, and keeps that in sight.
  const links = [...document.querySelectorAll("nav a")];
  const sections = links.map(link => document.getElementById(link.hash.slice(1)));
  let marked = null;
  function mark() {
    const line = 0.3 * window.innerHeight;
    let at = sections.findLastIndex(section => section.getBoundingClientRect().top <= line);
    if (window.innerHeight + window.scrollY >= root.scrollHeight - 2) { at = links.length - 1; }
    if (links[at] === marked) { return; }
    if (marked) { marked.removeAttribute("aria-current"); }
    marked = links[at] || null;
    if (!marked) { return; }
    marked.setAttribute("aria-current", "true");
    const bar = marked.closest("ul");
    bar.scrollLeft = marked.offsetLeft - (bar.clientWidth - marked.offsetWidth) / 2;
  }
  let waits = false;
  window.addEventListener("scroll", () => {
    if (waits) { return; }
    waits = true;
    requestAnimationFrame(() => { waits = false; mark(); });
  }, {passive: true});
  mark();

  // Tables: a click on a column's name sorts, words filter, and a button gives what is shown as CSV.
  const raw = cell => cell.dataset.raw === undefined ? cell.textContent : cell.dataset.raw;
  const words = new Intl.Collator("en", {numeric: true, sensitivity: "base"});

  function compare(a, b, numeric) {
    if (!numeric) { return words.compare(a, b); }
    const [x, y] = [parseFloat(a), parseFloat(b)];
    return Number.isNaN(x) || Number.isNaN(y) ? words.compare(a, b) : x - y;
  }

  function quoted(cell) {
    let text = raw(cell);
    // a spreadsheet would take it for a formula
    if (!cell.classList.contains("n") && /^[=+\-@\t\r]/.test(text)) { text = "'" + text; }
    return /[",\r\n]/.test(text) ? '"' + text.replaceAll('"', '""') + '"' : text;
  }

  function button(text, label) {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    if (label) { made.setAttribute("aria-label", label); }
    return made;
  }

  for (const grid of document.querySelectorAll(".grid")) {
    const table = grid.querySelector("table"), body = table.tBodies[0];
    const rows = [...body.rows], heads = [...table.tHead.rows[0].cells];
    const caption = table.caption.textContent;

    heads.forEach((head, column) => {
      const sorts = button("");
      sorts.append(...head.childNodes);
      head.append(sorts);
      sorts.addEventListener("click", () => {
        // once up, again down, a third time as it was
        const before = head.getAttribute("aria-sort");
        heads.forEach(other => other.removeAttribute("aria-sort"));
        const sign = before === "descending" ? 0 : before === "ascending" ? -1 : 1;
        if (sign) { head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending"); }
        const numeric = head.classList.contains("n");
        const sorted = sign === 0 ? rows : [...rows].sort((a, b) => {
          const [x, y] = [raw(a.cells[column]), raw(b.cells[column])];
          if (x === "" || y === "") { return (x === "") - (y === ""); } // what is missing comes last either way
          return sign * compare(x, y, numeric);
        });
        body.append(...sorted);
      });
    });

    const tools = document.createElement("div");
    tools.className = "tools";
    if (rows.length > 5) {
      const filter = document.createElement("input"), count = document.createElement("span");
      filter.type = "search";
      filter.placeholder = "Filter";
      filter.setAttribute("aria-label", "Filter: " + caption);
      count.setAttribute("role", "status");
      filter.addEventListener("input", () => {
        const asked = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
        let shown = 0;
        for (const row of rows) {
          const text = [...row.cells].map(cell => cell.textContent).join(" ").toLowerCase();
          row.hidden = !asked.every(word => text.includes(word));
          shown += !row.hidden;
        }
        count.textContent = asked.length ? shown + " of " + rows.length + " rows" : "";
      });
      tools.append(filter, count);
    }
    const download = button("CSV", "Download as CSV: " + caption);
    download.addEventListener("click", () => {
      const lines = [table.tHead.rows[0], ...[...body.rows].filter(row => !row.hidden)];
      const text = lines.map(row => [...row.cells].map(quoted).join(",") + "\r\n").join("");
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([text], {type: "text/csv;charset=utf-8"}));
      link.download = grid.dataset.file + ".csv";
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    });
    tools.append(download);
    grid.before(tools);
  }

  // What a chart says of a mark: pointed at, tapped, or reached by the arrow keys once the chart has the focus.
  const tip = document.getElementById("tip");
  let told = null;
  function tell(mark) {
    if (told) { told.classList.remove("told"); }
    told = mark;
    tip.hidden = !mark;
    if (!mark) { return; }
    mark.classList.add("told");
    tip.textContent = mark.getAttribute("aria-label");
    const box = mark.getBoundingClientRect(), own = tip.getBoundingClientRect();
    const wide = root.clientWidth;
    const left = Math.min(Math.max(box.left + box.width / 2 - own.width / 2, 8), wide - own.width - 8);
    const above = box.top - own.height - 8;
    tip.style.left = Math.max(left, 8) + "px";
    tip.style.top = (above > 60 ? above : Math.min(box.bottom + 8, window.innerHeight - own.height - 8)) + "px";
  }
  for (const mark of document.querySelectorAll("svg .tip")) {
    const title = mark.querySelector("title");
    mark.setAttribute("role", "img");
    mark.setAttribute("aria-label", title.textContent);
    title.remove(); // else the browser shows it, too
  }
  document.addEventListener("pointerover", event => {
    if (event.pointerType === "mouse") { tell(event.target.closest("svg .tip")); }
  });
  document.addEventListener("click", event => tell(event.target.closest("svg .tip")));
  document.addEventListener("focusout", () => tell(null));
  window.addEventListener("scroll", () => { if (told && !told.matches(":hover")) { tell(null); } }, {passive: true});
  document.addEventListener("keydown", event => {
    if (event.key === "Escape") { tell(null); }
    const chart = document.activeElement.closest("svg[tabindex]");
    if (!chart) { return; }
    const marks = [...chart.querySelectorAll(".tip")], at = marks.indexOf(told);
    const next = {
      ArrowRight: at + 1, ArrowDown: at + 1, ArrowLeft: at < 0 ? marks.length - 1 : at - 1, ArrowUp: at < 0 ? marks.length - 1 : at - 1,
      Home: 0, End: marks.length - 1,
    }[event.key];
    if (next === undefined) { return; }
    event.preventDefault();
    tell(marks[(next + marks.length) % marks.length]);
  });
}());
