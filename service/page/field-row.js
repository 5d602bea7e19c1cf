// One field of the form: its label, input, slider, unit and error message.

import { valueAt } from "./case.js";
import { nodeAt } from "./contract.js";
import { acceptDroppedFile, element, showText } from "./elements.js";
import { readValue } from "./field-value.js";
import { linesOf, openShown, shotShown, shownNumber, shownValue } from "./fields.js";
import { unitOf } from "./units.js";
import { quantityShown } from "./words.js";

const REST_MS = 1500; // pause in typing after which a value that is not accepted is refused

const SI_UNIT = / ?\[(?:1|°|m|m\/s|rad\/s|kg|kg m²|kg\/m³|Pa)\]/g;

/**
 * Build the row of a field.
 *
 * @param {object} field as `fieldOf` of fields.js returns it
 * @param {object} values the case
 * @param {{accept: (value: any) => void, hold: () => void, refuse: (problem: string) => void, currentOf?: () => object}} listener `accept` is called with
 *   each valid value, `hold` while an invalid one may be incomplete, `refuse` once the field is left or typing pauses; `currentOf` returns the current case
 * @returns {{field: object, root: HTMLElement, input: HTMLElement, problem: HTMLElement, described: string, later: (act?: () => void) => void}}
 *   `later` calls a function once the field is left or typing pauses, unless the text changes first
 */
export function buildRow(field, values, { accept, hold, refuse, currentOf = () => values }) {
  const id = `field-${field.path.replaceAll(".", "-")}`;
  let [timer, settle] = [undefined, undefined];
  const later = (act) => {
    clearTimeout(timer);
    settle = act;
    timer = act && setTimeout(act, REST_MS);
  };
  const read = (given) => {
    const { value, wrong, note = "" } = readValue(field, given, values);
    showText(understood, note);
    later(wrong && (() => refuse(wrong)));
    if (wrong) hold();
    else accept(value);
    return value;
  };
  const input = INPUTS[field.kind](field, values, read);
  input.addEventListener("change", () => {
    settle?.();
    later();
    if (field.kind !== "number" || Number.isFinite(Number(input.value))) return;
    const { value, wrong } = readValue(field, input.value, values);
    if (!wrong) input.value = value === undefined ? "" : shownNumber(field, value); // the number that was understood
  });
  input.id = id;
  const understood = element("output.note.understood", { id: `${id}-understood`, for: id });
  const notes = [
    field.unit && element("span.unit", { id: `${id}-unit` }, field.unit),
    field.slider && buildSlider(field, values, input, read),
    field.fill && element("button.fill", { type: "button", onclick: () => fillIn(input, shownNumber(field, field.fill.of(currentOf()))) }, field.fill.name),
    field.note && element("span.note", { id: `${id}-note` }, field.note),
    helpOf(field, values) && element("span.note.help", { id: `${id}-help` }, helpOf(field, values)),
  ].filter(Boolean);
  const problem = element("p.problem", { id: `${id}-problem`, hidden: true });
  const described = notes.map((note) => note.id).filter(Boolean).join(" ");
  const kind = field.kind === "flag" ? "div.field.flag" : "div.field";
  const root = element(kind, {}, element("label", { for: id }, field.label), input, ...notes, understood, problem);
  const row = { field, root, input, problem, described, later };
  showProblem(row, "");
  return row;
}

/** Fill in a field as if the value were typed; its slider follows. */
export function fillIn(input, value) {
  input.value = value;
  input.dispatchEvent(new Event("input"));
  input.dispatchEvent(new Event("change"));
}

/** Show an error message at a field; an empty text removes it. */
export function showProblem({ root, input, problem, described }, text) {
  problem.hidden = !text;
  showText(problem, text);
  const set = (name, value) => (value ? input.setAttribute(name, value) : input.removeAttribute(name));
  set("aria-describedby", [described, text && problem.id].filter(Boolean).join(" "));
  set("aria-invalid", text && "true");
  for (let group = text && root.closest("details"); group; group = group.parentElement.closest("details")) group.open = true;
  if (text && input.matches("textarea")) problem.scrollIntoView({ block: "nearest" }); // it is below a high box
}

/** Return the description of a field from the contract, without the unit in brackets. */
function helpOf({ path, kind }, values) {
  const isTyped = kind === "number" || kind === "numbers" || kind === "shots";
  return isTyped ? nodeAt(path, values)?.description?.replaceAll(SI_UNIT, "").trim() : undefined;
}

const INPUTS = {
  number(field, values, read) {
    const { default: usual } = nodeAt(field.path, values) ?? {};
    return element("input", {
      type: "text",
      inputmode: "decimal",
      autocomplete: "off",
      spellcheck: "false",
      placeholder: field.optional && (openShown(field) ?? (usual === undefined ? "auto" : shownNumber(field, usual))),
      value: shownValue(field, values) ?? "",
      oninput: ({ target }) => read(target.value),
    });
  },
  choice(field, values, read) {
    const given = valueAt(values, field.path) ?? nodeAt(field.path, values).default;
    const option = ([value, text]) => element("option", { value, selected: value === String(given ?? "") }, text);
    const open = field.classes ? [["", "no class"]] : [];
    const other = field.classes && given !== undefined && !(given in field.classes) ? [[given, `${quantityShown(given, "MPa")} characteristic`]] : [];
    const taken = (text) => (field.classes ? (text === "" ? undefined : Number(text)) : text);
    const options = [...open, ...other, ...Object.entries(field.choices)].map(option);
    return element("select", { onchange: ({ target }) => read(taken(target.value)) }, ...options);
  },
  flag(field, values, read) {
    const checked = Boolean(valueAt(values, field.path));
    return element("input", { type: "checkbox", checked, onchange: ({ target }) => read(target.checked) });
  },
  shots: buildShots,
  numbers(field, values, read) {
    return buildArea(linesOf(field, values).join(field.pairs ? "\n" : ", "), read, { rows: field.pairs ? 4 : 2, placeholder: field.optional && "auto" });
  },
};

function buildArea(text, read, attributes) {
  return element("textarea", { spellcheck: "false", oninput: ({ target }) => read(target.value), ...attributes }, text);
}

/** Build the input of shots, which shows them as text in the units shown; a dropped file replaces them. */
function buildShots(field, values, read) {
  const shown = (value, si) => shownNumber(unitOf(si), value);
  const lines = (valueAt(values, field.path) ?? []).map((shot) => `${shown(shot.velocity_m_s, "m/s")}, ${shown(shot.depth_m, "mm")}`);
  const example = [{ velocity_m_s: 250, depth_m: 0.31 }, { velocity_m_s: 300, depth_m: 0.42 }].map((shot) => shotShown(shot, 3));
  const area = buildArea(lines.join("\n"), read, { rows: 4, placeholder: `none yet, as in\n${example.join("\n")}` });
  acceptDroppedFile(area);
  return area;
}

function buildSlider(field, values, input, read) {
  const [least, most, step] = field.slider;
  const [min, max] = [least, most].map((end) => (field.unit === field.si ? end : Math.round(end / field.factor)));
  const slider = element("input", {
    type: "range",
    min,
    max,
    step,
    value: shownValue(field, values),
    "aria-label": `${field.label}, slider`,
    oninput() {
      input.value = slider.value;
      read(slider.value);
    },
  });
  input.addEventListener("input", () => {
    const { value } = readValue(field, input.value, values);
    if (value !== undefined) slider.value = shownNumber(field, value);
  });
  return slider;
}
