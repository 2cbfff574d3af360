// Icons, tooltips, keys, theme: what every control of the page has in common.

/** An element with class and text; text is never markup. */
export function el(tag, className = "", text = "") {
  const e = document.createElement(tag);
  if (className) e.className = className;
  if (text) e.textContent = text;
  return e;
}

/** The icon of that name as an SVG element. */
export function icon(name) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg"), use = document.createElementNS(svg.namespaceURI, "use");
  svg.setAttribute("viewBox", "0 0 20 20");
  svg.setAttribute("class", "icon");
  use.setAttribute("href", `#i-${name}`);
  svg.append(use);
  return svg;
}

/** A small button with a name from the file. */
export function chip(text, tip, act, className = "") {
  const button = el("button", `chip ${className}`, text);
  button.dataset.tip = tip;
  button.onclick = act;
  return button;
}

/** Put its icon into each button; returns a function that changes one. */
export function icons() {
  const set = (button, name) => button.replaceChildren(icon(name));
  for (const button of document.querySelectorAll("[data-icon]")) {
    set(button, button.dataset.icon);
    button.setAttribute("aria-label", button.dataset.tip);
    if (button.dataset.key) button.setAttribute("aria-keyshortcuts", button.dataset.key);
  }
  return set;
}

/** One tooltip for all elements with data-tip, shown after a moment or on keyboard focus. */
export function tooltips(tip) {
  let timer = 0;
  const hide = () => { clearTimeout(timer); tip.hidden = true; };
  const show = (target) => {
    const { tip: text, key } = target.dataset, box = target.getBoundingClientRect();
    tip.textContent = text;
    if (key) { const b = document.createElement("b"); b.textContent = key; tip.append(b); }
    tip.hidden = false;
    const w = tip.offsetWidth, h = tip.offsetHeight;
    tip.style.left = `${Math.max(6, Math.min(innerWidth - w - 6, box.left + box.width / 2 - w / 2))}px`;
    tip.style.top = `${box.bottom + h + 10 < innerHeight ? box.bottom + 8 : box.top - h - 8}px`;
  };
  document.addEventListener("pointerover", (e) => {
    const target = e.target.closest?.("[data-tip]");
    hide();
    if (target && e.pointerType !== "touch") timer = setTimeout(() => show(target), 350);
  });
  document.addEventListener("pointerdown", hide);
  document.addEventListener("focusin", (e) => { if (e.target.matches?.("[data-tip]:focus-visible")) show(e.target); });
  document.addEventListener("focusout", hide);
}

/** Keys: {"Space": fn, "Ctrl+Z": fn, ...}; ignored while text is being typed. */
export function keys(table) {
  document.addEventListener("keydown", (e) => {
    const typing = e.target.matches?.("input[type=search], input[type=text], input[type=number], textarea");
    if (typing) { if (e.key === "Escape") e.target.blur(); return; }
    const arrows = e.key.startsWith("Arrow") || e.key === "Home" || e.key === "End";
    if (arrows && e.target.matches?.("input[type=range], select")) return;
    if (e.key === " " && e.target.matches?.("summary, input[type=checkbox]")) return; // it opens or ticks these
    if (e.key === "Enter" && e.target.matches?.("summary, button, select, a, input, [tabindex]:not(canvas)")) return; // works these
    let name = e.key === " " ? "Space" : e.key.length === 1 ? e.key.toUpperCase() : e.key;
    if (e.ctrlKey || e.metaKey) name = `Ctrl+${e.shiftKey ? "Shift+" : ""}${name}`;
    else if (e.altKey) return;
    const act = table[name];
    if (!act) return;
    e.preventDefault();
    act();
  });
}

/** Dark or light: what was chosen last, else what the system prefers. `apply(name)` is called at once. */
export function theme(button, apply) {
  let kept = null;
  try { kept = localStorage.getItem("vitruvian-theme"); } catch { /* pages from disk may not keep anything */ }
  let name = kept ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
  const set = () => { document.documentElement.dataset.theme = name; apply(name); };
  button.onclick = () => {
    name = name === "dark" ? "light" : "dark";
    try { localStorage.setItem("vitruvian-theme", name); } catch { /* as above */ }
    set();
  };
  set();
}

/** Fill the list of keys from the controls themselves. */
export function keyList(root) {
  const rows = [...document.querySelectorAll("[data-key]:not([data-key=arrows]):not([data-key^=Tab])")].map((e) => [e.dataset.key, e.dataset.tip]);
  rows.push(["drag", "Turn the camera"], ["right drag", "Move the camera"], ["wheel", "Come closer, go away"], ["Esc", "Close panels and lists"]);
  root.replaceChildren(...rows.flatMap(([key, text]) => {
    const k = document.createElement("kbd"), t = document.createElement("span");
    k.textContent = key;
    t.textContent = text;
    return [k, t];
  }));
}

export function download(blob, name) {
  const a = document.createElement("a");
  a.href = URL.createObjectURL(blob);
  a.download = name;
  a.click();
  setTimeout(() => URL.revokeObjectURL(a.href), 10000);
}
