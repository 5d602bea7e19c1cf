// The visible parts of a map: the progress of its job, the picture, and the description of one case.

import { announce, element } from "./elements.js";
import { slug } from "./exports.js";
import { fieldAt, labelWithUnit, shownValue } from "./fields.js";
import { progressWords } from "./job-progress.js";
import { buildCellChoice } from "./map-cell.js";
import { cellsCsv, countWords, QUANTITIES } from "./map-cells.js";
import { isInert } from "./map-curve.js";
import { mapLayout, mapTraces } from "./map-plot.js";
import { endWords } from "./map-run.js";
import { draw, purge } from "./plots.js";
import { markFresh, markPending, markSettled, markStale, markUntilRun } from "./stale.js";
import { inputField } from "./scatter.js";
import { caseAt, hasAngle, isOfAngle, numbers, OPERATIONS } from "./sweep.js";
import { valueAt } from "./case.js";
import { nodeAt } from "./contract.js";
import { unitOf } from "./units.js";

/** The panels of a map. */
export class MapPicture {
  #map;
  #axes;
  #content; // arguments of `showCells`, each from the latest call that gave it
  #isDrawn = false; // whether cells of the map are drawn
  #isSame = true; // whether the inputs in the form are those of the map

  /**
   * @param {HTMLElement} root
   * @param {(ends: number[]) => void} onDrag called with the values on both axes to which the case is dragged, in SI
   */
  constructor(root, onDrag) {
    this.onDrag = onDrag;
    this.heading = element("h2");
    this.bar = element("progress", { "aria-label": "Cases computed" });
    this.words = element("p", { id: "map-progress" });
    this.counts = element("p.quiet", { id: "map-counts" });
    this.plot = element("div.map");
    this.cell = element("section.panel.one-case", { hidden: true, "aria-label": "One case" });
    this.panel = element("section.panel", { hidden: true, "aria-label": "Picture" });
    this.panel.append(this.heading, this.bar, this.words, this.plot, this.counts);
    this.choice = buildCellChoice(this.cell);
    this.handle = element("div.handle", {
      "aria-hidden": true, // keyboard users change the fields instead
      onpointerdown: ({ pointerId }) => this.handle.setPointerCapture(pointerId),
      onpointermove: (event) => event.buttons && this.#drag(event),
    });
    this.root = element("div.column", {}, this.panel, this.cell);
    root.append(this.root);
  }

  /** Start to show a map that has no results yet. */
  begin(map) {
    this.#map = map;
    this.#axes = [map.x, map.y].map(shownAxis);
    this.here = undefined;
    this.#content = {};
    this.panel.hidden = false;
    this.bar.removeAttribute("value");
    this.heading.textContent = titleOf(map, this.#axes);
    this.words.textContent = "Waiting for the service ...";
    this.root.hidden = false;
    this.#isDrawn = false;
    this.#isSame = true;
    markFresh(this.heading);
    markPending(this.words);
    markStale(...this.#ofCells);
  }

  /** Show the progress of the job. */
  showProgress(job) {
    this.#fill(job, progressWords(job));
  }

  /** Show how the job has ended. */
  showEnd(job) {
    this.#fill(job, endWords(job));
    markSettled(this.words);
    announce(endWords(job));
  }

  #fill({ counts: { total, done } }, words) {
    this.words.textContent = words;
    Object.assign(this.bar, { max: total, value: done });
  }

  /** Record that no more results follow, because of an error that is shown elsewhere. */
  giveUp() {
    markSettled(this.words, "");
  }

  /** Mark the results as current or as those of previous inputs; hide them while a field is not accepted. */
  compare(isSame, isAccepted) {
    this.#isSame = isSame;
    this.root.hidden = !isAccepted;
    if (isAccepted && !isSame) markUntilRun(this.heading, ...this.#ofCells);
    else markFresh(this.heading, ...(this.#isDrawn ? this.#ofCells : []));
  }

  get #ofCells() {
    return [this.plot, this.counts, this.cell];
  }

  /** Draw the cells computed so far, the coarse grid where there are none, and contours once no more cells follow. */
  async showCells(content) {
    Object.assign(this.#content, content);
    const { cells, rough = [], curve, isLast } = this.#content;
    const { operation } = this.#map;
    const { label, si } = QUANTITIES[operation] ?? { label: "Greatest depth", si: "mm" };
    const lines = labelWithUnit({ label: label.toLowerCase(), unit: unitOf(si).unit });
    const scatter = this.#map.study ? ` ${scatterWords(this.#map.study)}` : "";
    this.counts.textContent = `${countWords(operation, cells)}. Lines: ${lines}.${scatter}`;
    this.cell.hidden = false;
    this.choice.show(this.#map, this.#axes, cells);
    const about = {
      title: this.heading.textContent,
      values: this.#map.values,
      varied: this.#axes.map(({ field }) => field),
      key: this.#map.job && `job ${this.#map.job}`, // each case has its own key, in the CSV
      part: slug(nameOf(operation, this.#axes)).toLowerCase(),
      hasAngle: hasAngle(this.#map),
      csv: () => cellsCsv(operation, this.#axes, cells),
      label: `${this.heading.textContent}: ${this.counts.textContent} Below, each case can be chosen and read.`,
    };
    const isNew = !this.plot.querySelector(".drawing");
    this.here ??= this.#placeOf(this.#map.values);
    const traces = mapTraces(operation, this.#axes, cells, rough, this.#room(), this.here, (index) => this.#yieldOf(index), curve, isLast);
    const map = this.#map;
    const drawn = await draw(this.plot, traces, mapLayout(this.#axes), about);
    this.#isDrawn ||= map === this.#map;
    if (this.#isDrawn && this.#isSame) markFresh(...this.#ofCells);
    this.pick = (point) => {
      const [column, row] = [this.#axes[0].shown.indexOf(point.x), this.#axes[1].shown.indexOf(point.y)];
      if (column >= 0 && row >= 0) this.choice.choose({ column, row });
    };
    if (!isNew || !drawn) return;
    drawn.on("plotly_click", ({ points }) => this.pick(points[0]));
    drawn.on("plotly_legendclick", ({ data, curveNumber }) => !isInert(data[curveNumber]));
    drawn.on("plotly_legenddoubleclick", ({ data }) => !data.some(isInert)); // it would show or hide all entries
    drawn.on("plotly_afterplot", () => this.#placeHandle());
    this.plot.append(this.handle);
    this.#placeHandle();
  }

  /** Move the mark to a case that differs from the map's case only in the fields that vary. */
  setHere(values) {
    this.here = this.#placeOf(values);
    const drawn = this.plot.querySelector(".drawing");
    if (!drawn?.data) return;
    const [x, y] = this.here;
    window.Plotly.restyle(drawn, { x: [[x]], y: [[y]] }, [drawn.data.length - 1]);
    this.#placeHandle();
  }

  /** Return the stress above which the surface of the projectile of a cell yields [Pa]. */
  #yieldOf(index) {
    const { x } = this.#map;
    const { projectile } = caseAt(this.#map, { column: index % x.count, row: Math.floor(index / x.count) });
    return projectile.yield_strength_pa ?? fieldAt("projectile.yield_strength_pa").open;
  }

  #placeOf(values) {
    return this.#axes.map(({ field }) => shownValue(fieldAt(field), values));
  }

  #placeHandle() {
    const drawn = this.plot.querySelector(".drawing");
    const { left, top, width, height } = plottedArea(drawn);
    const { xaxis, yaxis } = drawn.layout;
    const [x, y] = this.here;
    this.handle.style.left = `${left + width * share(x, xaxis.range)}px`;
    this.handle.style.top = `${top + height * (1 - share(y, yaxis.range))}px`;
  }

  #drag({ clientX, clientY }) {
    const drawn = this.plot.querySelector(".drawing");
    const corner = drawn.getBoundingClientRect();
    const { left, top, width, height } = plottedArea(drawn);
    const across = (clientX - corner.left - left) / width;
    const up = 1 - (clientY - corner.top - top) / height;
    const places = [between(across, drawn.layout.xaxis.range), between(up, drawn.layout.yaxis.range)];
    this.onDrag(
      this.#axes.map(({ field, shown }, i) => {
        const inside = Math.min(Math.max(places[i], Math.min(...shown)), Math.max(...shown));
        return Number((Number(inside.toPrecision(3)) * fieldAt(field).factor).toPrecision(12));
      }),
    );
  }

  /** Return the size available for the mark of a cell [px]. */
  #room() {
    const { clientWidth, clientHeight } = this.plot;
    const [across, up] = this.#axes.map(({ shown: { length } }) => length);
    const side = 0.6 * Math.min(clientWidth / across, (clientHeight || clientWidth) / up);
    return Math.min(12, Math.max(2, side));
  }

  /** Forget the plot. */
  leave() {
    purge(this.plot);
  }
}

function shownAxis(axis) {
  const { label, unit, factor } = fieldAt(axis.field);
  const values = numbers(axis);
  return { field: axis.field, label, unit, values, shown: values.map((value) => Number((value / factor).toPrecision(6))) };
}

function scatterWords({ uncertain, sampling }) {
  const names = uncertain.map(({ field }) => inputField(field).label.toLowerCase());
  const most = sampling?.max_samples ?? nodeAt("sampling.max_samples", {}).default;
  return `${most} strikes a case, with the scatter of ${names.join(", ")}.`;
}

function titleOf({ operation, values }, axes) {
  const at = hasAngle({ operation }) && !axes.some(isOfAngle) ? `, at ${valueAt(values, "impact.oblique_angle_deg")}°` : "";
  const isOfWall = operation === "thickness" || (operation === "trajectory" && values.target.thickness_m !== undefined);
  return `${nameOf(operation, axes)}${at}${isOfWall ? ", by this model: not a design value" : ""}`;
}

function nameOf(operation, [x, y]) {
  const named = OPERATIONS[operation].label.replace(/ (at an angle|\(phase diagram\))$/, "");
  return `${named} over ${x.label.toLowerCase()} and ${y.label.toLowerCase()}`;
}

/** Return the rectangle between the axes of a drawing, relative to the corner of the drawing [px]. */
function plottedArea(drawn) {
  const corner = drawn.getBoundingClientRect();
  const { left, top, width, height } = drawn.querySelector(".nsewdrag").getBoundingClientRect();
  return { left: left - corner.left, top: top - corner.top, width, height };
}

/** Return the position of a value on an axis, from 0 at its start to 1 at its end. */
const share = (value, [begin, end]) => (value - begin) / (end - begin);

/** Return the value at a position on an axis from 0 to 1. */
const between = (part, [begin, end]) => begin + part * (end - begin);
