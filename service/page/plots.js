// A thin layer over Plotly: theme colours, downloads, and descriptions for screen readers.

import { element, save, svg } from "./elements.js";
import { fileName, titleLines, withHeader } from "./exports.js";
import { locate } from "./service.js";
import { themeChanges } from "./theme.js";
import { inShownColumns } from "./units.js";

const drawn = new Map();
const colours = new Map();
let loading;

/**
 * Draw or redraw a plot in an element, with buttons below it that download the picture and its data.
 *
 * @param {HTMLElement} root
 * @param {object[]} traces as Plotly takes them
 * @param {object} layout as Plotly takes it; it overrides the theme
 * @param {{title: string, values: object, key?: string, part?: string, hasAngle?: boolean, csv: () => string, label: string,
 *   again?: () => any}} about the description of the files (exports.js); `csv` returns the data, and `label` describes
 *   the picture; `again` redraws it after a change of theme, and is needed if the traces contain colours
 * @returns {Promise<HTMLElement|undefined>} the element that Plotly drew into, for its events
 */
export async function draw(root, traces, layout, about) {
  const Plotly = await loadPlotly();
  if (!root.isConnected) return undefined; // the view was left in the meantime
  const plot = drawingOf(root);
  drawn.set(root, { traces, layout, about, plot });
  plot.setAttribute("aria-label", about.label);
  await Plotly.react(plot, traces, themed(layout), { displayModeBar: false, responsive: true });
  return plot;
}

/**
 * Show an SVG picture in an element in place of the previous one, with the same buttons as a plot.
 *
 * @param {HTMLElement} root
 * @param {SVGElement} picture
 * @param {object} about as for `draw`
 */
export function place(root, picture, about) {
  const plot = drawingOf(root);
  drawn.set(root, { picture, about, plot });
  plot.setAttribute("aria-label", about.label);
  plot.replaceChildren(picture);
}

/** Return the element inside `root` that holds the drawing; it is created at the first call. */
export function drawingOf(root) {
  return root.querySelector(".drawing") ?? frame(root);
}

/** Change the layout of a plot, as `Plotly.relayout` does. */
export function relayout(root, change) {
  const plot = drawn.get(root)?.plot;
  return plot && window.Plotly.relayout(plot, change);
}

/** Forget a plot, and remove its event listeners. */
export function purge(root) {
  const { plot, picture } = drawn.get(root) ?? {};
  drawn.delete(root);
  if (plot && !picture) window.Plotly.purge(plot);
}

/** Return a colour of the theme by the name of its custom property, such as `accent`. */
export function colour(name) {
  const read = () => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  if (!colours.has(name)) colours.set(name, read());
  return colours.get(name);
}

/** Return Plotly's name for an axis of a panel: x, x2, x3 ... */
export function axis(name, panel) {
  return panel ? `${name}${panel + 1}` : name;
}

/** Return a heading above a panel; `x` and `y` are fractions of the whole picture. */
export function heading(text, x, y) {
  return { text, x, y, xref: "paper", yref: "paper", xanchor: "left", yanchor: "bottom", showarrow: false };
}

/** Return CSV text in the units shown, from columns of equal length by name, or from rows that all have the same columns. */
export function csvOf(given) {
  const columns = inShownColumns(Array.isArray(given) ? columnsOf(given) : given);
  const names = Object.keys(columns);
  const cell = (value) => (/[",\n]/.test(value) ? `"${String(value).replaceAll('"', '""')}"` : (value ?? ""));
  const rows = columns[names[0]].map((_, row) => names.map((name) => cell(columns[name][row])).join(","));
  return [names.join(","), ...rows, ""].join("\r\n");
}

function columnsOf(rows) {
  return Object.fromEntries(Object.keys(rows[0] ?? {}).map((name) => [name, rows.map((row) => row[name])]));
}

function loadPlotly() {
  loading ??= new Promise((resolve, reject) => {
    setStylesByObject();
    const script = element("script", {
      src: locate("page/plotly/plotly.min.js"),
      onload: () => resolve(window.Plotly),
      onerror: () => reject(new Error("the plotting library could not be loaded")),
    });
    document.head.append(script);
  });
  return loading;
}

/** Make Plotly set styles through the object model, because the content security policy forbids `style` attributes. */
function setStylesByObject() {
  const { setAttribute } = Element.prototype;
  Element.prototype.setAttribute = function set(name, value) {
    if (name === "style") this.style.cssText = value;
    else setAttribute.call(this, name, value);
  };
}

function frame(root) {
  const plot = element("div.drawing", { role: "img" });
  const download = (text, label, act) => element("button", { type: "button", "aria-label": label, onclick: act }, text);
  root.classList.add("plot");
  root.append(
    plot,
    element(
      "div.downloads",
      {},
      download("SVG", "Download the plot as SVG", () => savePicture(root, "svg")),
      download("PNG", "Download the plot as PNG", () => savePicture(root, "png")),
      download("CSV", "Download the data of the plot as CSV", () => {
        const { about } = drawn.get(root);
        save(withHeader(about.csv(), about), `${fileName(about)}.csv`, "text/csv");
      }),
    ),
  );
  return plot;
}

/** Download a picture with its title above it. */
async function savePicture(root, format) {
  const { plot, picture, traces, about } = drawn.get(root);
  const own = picture ? asText(picture) : await textOf(plot, traces);
  const lines = titleLines(about);
  const head = 18 * lines.length + 18;
  const [width, height] = [plot.clientWidth, plot.clientHeight + head];
  const title = lines.map((line, i) =>
    svg("text", { x: 10, y: 24 + i * 18, "font-size": i ? 11 : 15, "font-weight": i ? undefined : "bold" }, line),
  );
  const font = getComputedStyle(document.body).fontFamily;
  const whole = svg("svg", { width, height, viewBox: `0 0 ${width} ${height}`, "font-family": font, fill: colour("text") });
  whole.append(svg("rect", { width, height, fill: colour("panel") }), ...title);
  // Joined as text, because the content security policy would drop the styles of Plotly's elements if they were parsed.
  const text = asText(whole).replace("</svg>", () => `${own.replace("<svg", `<svg y="${head}"`)}</svg>`);
  if (format === "svg") return save(text, `${fileName(about)}.svg`, "image/svg+xml");
  const image = element("img", { src: URL.createObjectURL(new Blob([text], { type: "image/svg+xml" })) });
  await image.decode();
  const canvas = element("canvas", { width: 2 * width, height: 2 * height });
  canvas.getContext("2d").drawImage(image, 0, 0, 2 * width, 2 * height);
  URL.revokeObjectURL(image.src);
  return canvas.toBlob((png) => save(png, `${fileName(about)}.png`, "image/png"));
}

const asText = (picture) => new XMLSerializer().serializeToString(picture);

async function textOf({ clientWidth: width, clientHeight: height, layout }, data) {
  const url = await window.Plotly.toImage({ data, layout, config: {} }, { format: "svg", width, height });
  return decodeURIComponent(url.slice(url.indexOf(",") + 1));
}

function themed(layout) {
  const edge = colour("edge");
  const lines = {
    gridcolor: colour("grid"),
    zerolinecolor: edge,
    linecolor: edge,
    automargin: true,
    tickangle: 0,
    exponentformat: "none", // the suffixes k and M would conflict with the unit
    ticklabeloverflow: "allow", // otherwise each label that might be hidden is measured, which takes 1 ms or more
  };
  const made = {
    margin: { l: 8, r: 8, t: 8, b: 8 },
    paper_bgcolor: "transparent",
    plot_bgcolor: "transparent",
    font: { color: colour("text"), family: getComputedStyle(document.body).fontFamily, size: 12 },
    hoverlabel: { bgcolor: colour("panel"), bordercolor: colour("edge"), font: { color: colour("text") } },
    ...layout,
  };
  for (const name of new Set(["xaxis", "yaxis", ...Object.keys(layout)])) {
    if (/^[xy]axis\d*$/.test(name)) made[name] = { ...lines, ...layout[name] };
  }
  return made;
}

themeChanges.addEventListener("change", () => {
  colours.clear();
  for (const [root, { traces, layout, about }] of drawn) {
    if (about.again) about.again();
    else draw(root, traces, layout, about);
  }
});
