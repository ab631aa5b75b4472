"use strict";
(() => {
  const byId = (id) => document.getElementById(id);
  const form = byId("controls"), search = byId("search"), status = byId("status"), nothing = byId("nothing");
  const rows = [...document.querySelectorAll("tr[data-v]")];
  const parts = [...document.querySelectorAll(".subject-part")];
  const objects = [...document.querySelectorAll("tr[data-n]")];
  const edges = [...document.querySelectorAll(".edge[data-s]")];
  const boxes = [...document.querySelectorAll("a[data-n]")];
  const names = new Map();
  for (const part of parts) names.set(part.id.slice(1), part.querySelector("h3").textContent);
  for (const row of objects) names.set(row.dataset.n, row.querySelector(".node").textContent);
  const total = rows.filter((row) => row.closest(".subject-part")).length;

  // The text is the full name of a node, or a part of names.
  const matching = (text) => {
    if (!text) return null;
    const exact = [...names].filter(([, name]) => name === text);
    const matches = exact.length ? exact : [...names].filter(([, name]) => name.toLowerCase().includes(text.toLowerCase()));
    return new Set(matches.map(([number]) => number));
  };

  const apply = () => {
    const nodes = matching(search.value.trim());
    const verdicts = new Set([...form.querySelectorAll("[name=verdict]:checked")].map((box) => box.value));
    const verdictOf = (edge) => verdicts.has(edge.dataset.v);
    const wanted = (edge) => !nodes || edge.dataset.s.split(" ").some((s) => nodes.has(s)) || edge.dataset.o.split(" ").some((o) => nodes.has(o));
    const drawn = new Set();
    let shown = 0;
    for (const row of rows) {
      row.hidden = !(verdictOf(row) && wanted(row));
      if (!row.hidden) {
        drawn.add(row.dataset.s).add(row.dataset.o);
        if (row.closest(".subject-part")) shown += 1;
      }
    }
    for (const part of parts) {
      const filled = part.querySelector("tr[data-v]");
      part.hidden = filled ? !part.querySelector("tr[data-v]:not([hidden])") : Boolean(nodes && !nodes.has(part.id.slice(1)));
    }
    for (const row of objects) row.hidden = !drawn.has(row.dataset.n) && Boolean(nodes ? !nodes.has(row.dataset.n) : shown < total);
    for (const edge of edges) edge.classList.toggle("dim", !(verdictOf(edge) && wanted(edge)));
    for (const box of boxes) box.classList.toggle("dim", shown < total && !box.dataset.n.split(" ").some((n) => drawn.has(n)));
    nothing.hidden = shown > 0 || total === 0;
    status.textContent = `${shown} of ${total} edges`;
  };

  // A link to a part that a filter hides resets the filter.
  const reveal = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (target && target.closest("[hidden]")) {
      form.reset();
      apply();
      target.scrollIntoView();
    }
  };

  search.addEventListener("input", apply);
  form.addEventListener("change", apply);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(apply));
  window.addEventListener("hashchange", reveal);
  for (const box of boxes) {
    box.addEventListener("click", () => {
      search.value = names.get(box.dataset.n.split(" ")[0]) ?? "";
      apply();
    });
  }
  document.addEventListener("keydown", (event) => {
    if (event.key === "/" && !event.ctrlKey && !event.metaKey && document.activeElement !== search) {
      event.preventDefault();
      search.focus();
      search.select();
    } else if (event.key === "Escape") {
      form.reset();
    }
  });
  form.hidden = false;
  apply();
})();
