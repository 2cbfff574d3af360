// Levels of detail by hand: how much of the surface is drawn. By itself the page draws all of it, or, where a processor
// does the drawing and a clip plays, as much as can be told apart; these levels show what a figure is from afar.

const $ = (id) => document.getElementById(id);
// Metres within which points are drawn as one on somebody 1.75 m tall; null: as the machine can.
const STEPS = [[null, "by itself"], [0, "all"], [0.004, "fewer"], [0.009, "few"], [0.018, "as from afar"]];

export class Fineness {
  constructor(page) {
    Object.assign(this, { page, step: 0 });
    $("fineness").onclick = () => this.choose((this.step + 1) % STEPS.length);
  }

  /** Metres for a figure; `usual` when nothing was chosen. Columns side by side that show edges show all of these. */
  cell(figure, usual) {
    const [chosen] = STEPS[this.step], edges = $("wire").getAttribute("aria-pressed") === "true";
    return chosen === null ? usual : this.page.compare.on && edges ? 0 : chosen * (figure.stature / 1.75);
  }

  choose(step) {
    this.step = step;
    $("fineness").setAttribute("aria-pressed", String(step > 0));
    this.apply();
    const { page } = this, text = `Detail: ${STEPS[step][1]}, ${page.triangles().toLocaleString("en")} triangles`;
    page.state(text);
    setTimeout(() => { if ($("notice").textContent === text) page.state(""); }, 2500);
  }

  /** Draw the figures as chosen, also while nothing plays. */
  apply() {
    const { page } = this;
    for (const figure of page.figures.values()) {
      if (!figure.isBody) continue;
      figure.byHand = this.step > 0;
      figure.detail(this.cell(figure, 0));
      if (figure.sparse) figure.served = null;
      figure.refresh();
    }
    page.looks();
  }
}
