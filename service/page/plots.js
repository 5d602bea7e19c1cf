// A thin layer over Plotly: colours of the theme, downloads, words for those who do not see the picture.

import { element, save } from "./elements.js";
import { fileName, headPx, withHeader, withTitle } from "./exports.js";
import { locate } from "./service.js";
import { themeChanges } from "./theme.js";

const drawn = new Map();
const colours = new Map();
let loading;

/**
 * Draw a plot, or draw it anew, into an element; buttons for its picture and its data are put below it.
 *
 * @param {HTMLElement} root
 * @param {object[]} traces as Plotly takes them
 * @param {object} layout as Plotly takes it; it takes precedence over the theme
 * @param {{title: string, values: object, key?: string, part?: string, hasAngle?: boolean, csv: () => string, label: string,
 *   again?: () => any}} about names and description of the files (exports.js), the data, the description of the
 *   picture, and what draws it again in the colours of another theme, if the traces hold any
 * @returns {Promise<HTMLElement|undefined>} the element that Plotly drew into, for its events
 */
export async function draw(root, traces, layout, about) {
  const Plotly = await loadPlotly();
  if (!root.isConnected) return undefined; // the view was left meanwhile
  const plot = root.querySelector(".drawing") ?? frame(root);
  drawn.set(root, { traces, layout, about, plot });
  plot.setAttribute("aria-label", about.label);
  await Plotly.react(plot, traces, themed(layout), { displayModeBar: false, responsive: true });
  return plot;
}

/** Change some attributes of traces that are drawn, as `Plotly.restyle` does. */
export function restyle(root, change, traces) {
  const plot = drawn.get(root)?.plot;
  return plot && window.Plotly.restyle(plot, change, traces);
}

/** Change the layout of what is drawn, as `Plotly.relayout` does. */
export function relayout(root, change) {
  const plot = drawn.get(root)?.plot;
  return plot && window.Plotly.relayout(plot, change);
}

/** Forget a plot, and what it listened to. */
export function purge(root) {
  const plot = drawn.get(root)?.plot;
  drawn.delete(root);
  if (plot) window.Plotly.purge(plot);
}

/** Return a colour of the theme by the name of its custom property, such as `accent`. */
export function colour(name) {
  const read = () => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  if (!colours.has(name)) colours.set(name, read());
  return colours.get(name);
}

/** Return CSV text of columns of equal length, by name. */
export function csvOf(columns) {
  const names = Object.keys(columns);
  const cell = (value) => (/[",\n]/.test(value) ? `"${String(value).replaceAll('"', '""')}"` : (value ?? ""));
  const rows = columns[names[0]].map((_, row) => names.map((name) => cell(columns[name][row])).join(","));
  return [names.join(","), ...rows, ""].join("\r\n");
}

function loadPlotly() {
  loading ??= new Promise((resolve, reject) => {
    setStylesByObject();
    const script = element("script", {
      src: locate("page/plotly/plotly.min.js"),
      onload: () => resolve(window.Plotly),
      onerror: () => reject(new Error("what draws the plots could not be loaded")),
    });
    document.head.append(script);
  });
  return loading;
}

/** Plotly sets `style` attributes, which the policy of the page forbids; through the object model it allows them. */
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

async function savePicture(root, format) {
  const { plot, traces, about } = drawn.get(root);
  const { width, height } = plot.getBoundingClientRect();
  const layout = withTitle({ ...plot.layout, paper_bgcolor: colour("panel") }, about);
  const picture = { data: traces, layout, config: {} };
  const url = await window.Plotly.toImage(picture, { format, width, height: height + headPx(about), scale: format === "png" ? 2 : 1 });
  const content = url.slice(url.indexOf(",") + 1);
  if (format === "svg") save(decodeURIComponent(content), `${fileName(about)}.svg`, "image/svg+xml");
  else save(Uint8Array.from(atob(content), (byte) => byte.charCodeAt(0)), `${fileName(about)}.png`, "image/png");
}

function themed(layout) {
  const edge = colour("edge");
  const lines = {
    gridcolor: colour("grid"),
    zerolinecolor: edge,
    linecolor: edge,
    automargin: true,
    tickangle: 0,
    ticklabeloverflow: "allow", // each label that might be hidden is measured, a millisecond or more
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
