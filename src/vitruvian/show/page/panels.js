// The joint tree. Names from files go in as text, never as markup.

import { el } from "./controls.js";

/** Rows for the joints of `figure` at its level; `on.select(j)`, `on.point(j or -1)` while the pointer is on a row. */
export class JointTree {
  constructor(root, filter, on) {
    Object.assign(this, { root, filter, on, rows: [], selected: -1 });
    filter.addEventListener("input", () => this.search());
  }

  show(figure) {
    this.figure = figure;
    this.selected = -1;
    this.rows = figure.joints.map((name, j) => this.row(name, j));
    this.relevel();
    const depth = [];
    for (const j of this.shown) {
      depth[j] = figure.above[j] < 0 ? 0 : depth[figure.above[j]] + 1;
      this.unfold(j, depth[j] < 3);
    }
  }

  /** Hang the rows of the joints that the level keeps below each other, and no others. */
  relevel() {
    const { kept, above } = this.figure, children = this.rows.map(() => []);
    this.shown = [...kept.keys()].filter((j) => kept[j] === j);
    for (const { item } of this.rows) item.remove();
    for (const j of this.shown) if (above[j] >= 0) children[above[j]].push(j);
    for (const j of this.shown) {
      const { item, list } = this.rows[j];
      (above[j] < 0 ? this.root : this.rows[above[j]].list).append(item);
      item.classList.toggle("leaf", !children[j].length);
      list.classList.toggle("branch", children[j].length > 1); // a chain of single joints hardly moves to the right
    }
    this.search();
  }

  unfold(j, open) {
    const { item } = this.rows[j];
    item.classList.toggle("unfolded", open);
    if (item.classList.contains("leaf")) item.removeAttribute("aria-expanded");
    else item.setAttribute("aria-expanded", String(open));
  }

  toggle(j) { this.unfold(j, !this.rows[j].item.classList.contains("unfolded")); }

  row(name, j) {
    const item = el("li", "joint"), row = el("div", "row"), fold = el("button", "fold"), list = el("ul");
    item.setAttribute("role", "treeitem");
    item.dataset.testid = `joint-${name}`;
    list.setAttribute("role", "group");
    fold.setAttribute("aria-label", `Fold ${name}`);
    fold.tabIndex = -1;
    fold.onclick = (e) => { e.stopPropagation(); this.toggle(j); };
    const label = el("span", "name", name);
    label.title = name;
    row.append(fold, label, el("span", "mark"), el("span", "dot"));
    row.tabIndex = 0;
    row.onclick = () => this.on.select(this.selected === j ? -1 : j);
    row.onpointerenter = () => this.on.point(j);
    row.onpointerleave = () => this.on.point(-1);
    row.onkeydown = (e) => {
      if (e.key === "Enter") row.onclick();
      if (e.key === "ArrowRight" || e.key === "ArrowLeft") { this.unfold(j, e.key === "ArrowRight"); e.stopPropagation(); }
      if (e.key === "ArrowDown" || e.key === "ArrowUp") this.step(row, e.key === "ArrowDown" ? 1 : -1, e);
    };
    item.append(row, list);
    return { item, list, row };
  }

  /** Move the focus to the next or the last visible row. */
  step(row, by, e) {
    const all = [...this.root.querySelectorAll(".row")].filter((r) => r.offsetParent), to = all[all.indexOf(row) + by];
    if (to) to.focus();
    e.preventDefault();
    e.stopPropagation();
  }

  select(j) {
    this.rows[this.selected]?.item.classList.remove("selected");
    this.rows[this.selected]?.item.setAttribute("aria-selected", "false");
    this.selected = j;
    const row = this.rows[j];
    if (!row) return;
    row.item.classList.add("selected");
    row.item.setAttribute("aria-selected", "true");
    for (let p = this.figure.above[j]; p >= 0; p = this.figure.above[p]) this.unfold(p, true);
    if (this.root.offsetParent) row.row.scrollIntoView({ block: "nearest" });
  }

  marks() { this.rows.forEach(({ item }, j) => item.classList.toggle("turned", this.figure.turns.has(j))); }

  /** Severity of the worst finding of each joint, Map joint -> severity. */
  findings(worst) { this.rows.forEach(({ row }, j) => { row.querySelector(".mark").className = `mark ${worst.get(j) ?? ""}`; }); }

  search() {
    const text = this.filter.value.trim().toLowerCase(), { joints, above, otherNames } = this.figure;
    const called = (j) => joints[j].toLowerCase().includes(text) || String(otherNames[j]?.[1] ?? "").toLowerCase().includes(text);
    const keep = joints.map((_, j) => !text || called(j));
    for (let j = joints.length - 1; j >= 0; j--) if (keep[j] && above[j] >= 0 && this.figure.kept[j] === j) keep[above[j]] = true;
    this.rows.forEach(({ item }, j) => { item.classList.toggle("away", !keep[j]); if (text && keep[j]) this.unfold(j, true); });
  }
}
