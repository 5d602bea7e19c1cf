// One cell of a map, chosen from two lists, for users who cannot point at the picture.

import { address, caseQuery } from "./address.js";
import { element } from "./elements.js";
import { cellWords } from "./map-cells.js";
import { valueShown } from "./map-plot.js";
import { caseAt } from "./sweep.js";
import { warningShown } from "./words.js";

/**
 * Build the two lists, and the texts and links for the chosen cell.
 *
 * @param {HTMLElement} root
 * @returns {{show: (map: object, axes: object[], cells: object[]) => void, choose: (place: {column: number, row: number}) => void}}
 *   `show` shows the cells of a map, `choose` selects one of them
 */
export function buildCellChoice(root) {
  const [across, up] = ["x", "y"].map((side) => element("select", { id: `cell-${side}`, onchange: () => showChosen() }));
  const labels = [across, up].map(({ id }) => element("label", { for: id }));
  const words = element("output", { for: "cell-x cell-y" });
  const mind = element("p.quiet");
  const explore = element("a", {}, "Open in Explore");
  const search = element("a", {}, "Open in Critical angle");
  let shown;

  function showChosen() {
    const { map, cells } = shown;
    const [column, row] = [across.selectedIndex, up.selectedIndex];
    const cell = cells[row * map.x.count + column];
    const warnings = (cell?.warnings ?? []).map(warningShown).join(", ");
    words.textContent = cellWords(cell);
    mind.textContent = warnings && `Warnings: ${warnings}. Explore shows them in full.`;
    const query = caseQuery(caseAt(map, { column, row }, cell?.angle));
    explore.setAttribute("href", address("explore", query));
    search.setAttribute("href", address("critical-angle", query));
  }

  root.append(
    element("h2", {}, "One case"),
    ...[across, up].map((select, i) => element("div.field", {}, labels[i], select)),
    element("p", {}, words),
    mind,
    element("p.links", {}, explore, " ", search),
  );
  const choose = ({ column, row }) => {
    [across.selectedIndex, up.selectedIndex] = [column, row];
    showChosen();
  };
  const show = (map, axes, cells) => {
    const isOther = JSON.stringify(axes) !== JSON.stringify(shown?.axes); // otherwise the chosen cell stays
    if (isOther) [across, up].forEach((select, i) => fill(select, labels[i], axes[i]));
    shown = { map, axes, cells };
    showChosen();
  };
  return { show, choose };
}

function fill(select, label, axis) {
  label.textContent = axis.label;
  select.replaceChildren(...axis.shown.map((value) => element("option", {}, valueShown(value, axis))));
  select.selectedIndex = Math.floor(axis.shown.length / 2);
}
