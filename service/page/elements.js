// Helpers that build elements, and the status line.

import { isAbort } from "./service.js";

const BEFORE_UNIT = /(?<=\d) (?=%|°|kg|m\/s|rad\/s|g₀|(?:[km]?m|m?s|[MG]?Pa|k?N|k?J|in|ft|lbf?|[pk]si|kip)\b)/g;

/**
 * Create an HTML element.
 *
 * @param {string} name tag, with classes as in `p.warning`
 * @param {object} attributes `on...` are listeners; true sets an attribute without a value, false and undefined omit it
 * @param {...(Node|string)} children
 */
export function element(name, attributes = {}, ...children) {
  const [tag, ...classes] = name.split(".");
  const made = document.createElement(tag);
  if (classes.length) made.className = classes.join(" ");
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== undefined) made.setAttribute(key, value);
  }
  made.append(...children.map((child) => (typeof child === "string" ? unbroken(child) : child)));
  return made;
}

/** Set the text of an element, with no-break spaces before units. */
export function showText(root, text) {
  root.textContent = unbroken(text);
}

/** Return text with no-break spaces between numbers and their units. */
const unbroken = (text) => text.replace(BEFORE_UNIT, "\u00a0");

/** Create an SVG element; attributes that are undefined are omitted. */
export function svg(name, attributes = {}, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) if (value !== undefined) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/**
 * Return a table in an element that scrolls horizontally.
 *
 * @param {string} name `table` with its classes
 * @param {{heads: (string|Node)[], rows: (string|Node)[][], caption?: string, label?: string, isNamed?: boolean,
 *   isNumber?: (column: number) => boolean, classes?: string[]}} content with `isNamed` the first cell of each row is its header; with
 *   a `label` the table can be scrolled by keyboard; `isNumber` tells which columns are right-aligned; `classes` has one for each row
 */
export function table(name, { heads, rows, caption, label, isNamed = false, isNumber = () => false, classes = [] }) {
  const cell = (tag, i, attributes, content) => element(isNumber(i) ? `${tag}.number` : tag, attributes, content);
  const head = heads.map((content, i) => cell("th", i, { scope: "col" }, content));
  const cells = (row) => row.map((content, i) => (isNamed && !i ? cell("th", i, { scope: "row" }, content) : cell("td", i, {}, content)));
  const made = element(
    name,
    {},
    ...(caption ? [element("caption", {}, caption)] : []),
    element("thead", {}, element("tr", {}, ...head)),
    element("tbody", {}, ...rows.map((row, i) => element("tr", { class: classes[i] }, ...cells(row)))),
  );
  return element("div.wide", label ? { tabindex: 0, role: "group", "aria-label": label } : {}, made);
}

/** Return the form of a case beside its results. */
export const formBeside = (form, ...results) => element("div.sides", {}, element("div.panel", {}, ...form), element("div.pictures", {}, ...results));

/** Return a group of buttons that act on the case; a form disables them while one of its fields is not accepted. */
export const caseActions = (name, ...children) => element("fieldset.of-case", { "aria-label": name }, ...children);

/** Return a button that is disabled while its action runs; `onError` receives the error if the action fails. */
export function taskButton(text, attributes, act, onError) {
  const onclick = async () => {
    button.disabled = true;
    try {
      await act();
    } catch (error) {
      announce("");
      if (!isAbort(error)) onError(error);
    }
    button.disabled = false;
  };
  const button = element("button", { type: "button", ...attributes, onclick }, text);
  return button;
}

/** Let a file that is dropped on a text area replace its text, as if typed; browsers handle dropped text themselves. */
export function acceptDroppedFile(area) {
  area.addEventListener("dragover", (event) => event.preventDefault());
  area.addEventListener("drop", async (event) => {
    const [file] = event.dataTransfer.files;
    if (!file) return;
    event.preventDefault();
    area.value = await file.text();
    area.dispatchEvent(new Event("input"));
  });
}

/** Download content as a file. */
export function save(content, name, type) {
  const url = URL.createObjectURL(new Blob([content], { type }));
  element("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

let [said, away, isState] = ["", "", true];

/** Show text in the status line, which is read aloud: the state of the view (`ofState`), or the response to a user's action. */
export function announce(text, ofState = !text) {
  [said, isState] = [text, ofState];
  const status = document.getElementById("status");
  if (status.textContent !== (away || said)) status.textContent = away || said;
}

/** Show a state of the view, unless the status line shows the response to a user's action. */
export const announceQuietly = (text) => isState && announce(text, true);

/** Show that the service does not answer, in place of any other status; an empty text restores that status. */
export function announceAway(text) {
  away = text;
  announce(said, isState);
}
