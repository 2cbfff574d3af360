// What the H-Anim doctor found: a list that can be sifted, and the place in the figure that each finding is about.

import { el, icon } from "./controls.js";

export const SEVERITIES = ["error", "warning", "note"];
const KINDS = ["joint", "site", "displacer", "segment"];

/**
 * {kind, index, joint} of the thing that `where` names ("joint l_elbow", "HAnimSite joe_skull_tip", "hanim_l_hand"), or
 * null. A word for the kind decides between things of one name; a DEF's prefix is taken off when nothing else fits.
 */
export function placeOf(where, figure) {
  const words = String(where ?? "").split(/[^\w.\-]+/).filter(Boolean), said = KINDS.find((k) => words.some((w) => w.toLowerCase().replace(/^hanim/, "") === k));
  const index = {
    joint: new Map(figure.joints.map((n, i) => [n, i])), site: new Map(figure.sites.map((s, i) => [s.name, i])),
    displacer: new Map(figure.displacers.map((d, i) => [d.name, i])), segment: new Map(),
  };
  figure.segments.forEach((names, j) => { for (const n of names) if (!index.segment.has(n)) index.segment.set(n, j); });
  const find = (name) => {
    for (const kind of said ? [said, ...KINDS] : KINDS) {
      const i = index[kind].get(name);
      if (i === undefined) continue;
      return { kind, index: i, name, joint: kind === "joint" || kind === "segment" ? i : kind === "site" ? figure.sites[i].joint : figure.displacers[i].joint };
    }
    return null;
  };
  for (const word of words) { const found = find(word); if (found) return found; }
  for (const word of words) for (let cut = word.indexOf("_"); cut >= 0; cut = word.indexOf("_", cut + 1)) {
    const found = find(word.slice(cut + 1));
    if (found) return found;
  }
  return null;
}

/** The first joint that a message about the whole figure names, or null. */
function jointIn(message, figure) {
  const words = new Set(String(message ?? "").split(/[^\w.\-]+/)), j = figure.joints.findIndex((n) => words.has(n));
  return j < 0 ? null : { kind: "joint", index: j, name: figure.joints[j], joint: j };
}

/** `on.place(place)` when a finding that has one is chosen. */
export class Findings {
  constructor({ root, count, sift, panel }, on) {
    Object.assign(this, { root, count, sift, panel, on, items: [], hidden: new Set() });
  }

  show(findings, found, figure) {
    this.items = findings.map((f) => ({ ...f, severity: SEVERITIES.includes(f.severity) ? f.severity : "note", place: figure.isBody ? placeOf(f.where, figure) ?? jointIn(f.message, figure) : null }));
    this.root.replaceChildren(...this.items.map((f, n) => this.row(f, n)));
    this.count.textContent = found ? String(found) : "";
    if (!findings.length) this.root.append(el("li", "none", "Nothing to report."));
    if (found > findings.length) this.root.append(el("li", "none", `${found - findings.length} more are not listed; \u201cvitruvian check\u201d lists all.`));
    const numbers = SEVERITIES.map((s) => this.items.filter((f) => f.severity === s).length);
    this.sift.hidden = numbers.filter(Boolean).length < 2;
    this.sift.replaceChildren(...SEVERITIES.flatMap((s, i) => (numbers[i] ? [this.sieve(s, numbers[i])] : [])));
    this.panel.dataset.worst = SEVERITIES[numbers.findIndex(Boolean)] ?? "";
    if (numbers[0] && innerWidth > 480) this.panel.open = true; // errors are what the file was opened for; a telephone has no room
  }

  sieve(severity, number) {
    const button = el("button", `sieve ${severity}`);
    button.append(icon(severity), el("span", "", `${number} ${severity}${number > 1 ? "s" : ""}`));
    button.dataset.testid = `sift-${severity}`;
    button.dataset.tip = `Show or hide the ${severity}s`;
    button.setAttribute("aria-pressed", String(!this.hidden.has(severity)));
    button.onclick = () => {
      if (!this.hidden.delete(severity)) this.hidden.add(severity);
      button.setAttribute("aria-pressed", String(!this.hidden.has(severity)));
      this.siftRows();
    };
    return button;
  }

  siftRows() { this.items.forEach((f, n) => { this.root.children[n].hidden = this.hidden.has(f.severity); }); }

  row(f, n) {
    const item = el("li", f.severity), head = el("div", "head"), where = el("div", "where");
    const mark = icon(f.severity);
    mark.setAttribute("aria-label", f.severity);
    head.append(mark, el("b", "code", f.rule ?? ""), el("span", "at", f.where ?? ""));
    item.dataset.testid = `finding-${n}`;
    item.append(head, el("p", "", f.message ?? f.rule ?? ""));
    if (f.fix) { where.append(el("b", "", "Fix: "), f.fix); item.append(where); }
    if (f.line) head.append(el("span", "line", `line ${f.line}`));
    if (f.place) {
      item.classList.add("link");
      item.tabIndex = 0;
      item.setAttribute("role", "button");
      item.dataset.tip = `Show ${f.place.name} in the figure`;
      item.onclick = () => { this.mark(n); this.on.place(f.place); };
      item.onkeydown = (e) => { if (e.key === "Enter") item.onclick(); };
    }
    return item;
  }

  /** Show finding `n` in the list. */
  mark(n) {
    [...this.root.children].forEach((item, i) => item.classList.toggle("chosen", i === n));
    this.root.children[n]?.scrollIntoView({ block: "nearest" });
  }

  /** Map joint -> [{n, severity, text}], and Map joint -> worst severity. */
  byJoint(kept) {
    const all = new Map(), worst = new Map();
    this.items.forEach((f, n) => {
      if (!f.place) return;
      const j = kept[f.place.joint];
      all.set(j, [...(all.get(j) ?? []), { n, severity: f.severity, text: `${f.rule ?? ""} ${f.message ?? ""}`.trim() }]);
      if (!worst.has(j) || SEVERITIES.indexOf(f.severity) < SEVERITIES.indexOf(worst.get(j))) worst.set(j, f.severity);
    });
    return { all, worst };
  }
}
