// Cases pasted as a table: a header with field names, and one case in each row.

import { readParameter } from "./address.js";
import { angleRequest, trajectoryRequest, withValue } from "./case.js";
import { nodeAt } from "./contract.js";
import { numericFields, withSphere } from "./fields.js";

const PARTS = ["", "impact.", "projectile.", "projectile.nose.", "target."]; // tried in this order for a header that is only the last name of a field
const ID = "custom_id";
const REQUESTS = { trajectory: trajectoryRequest, cra: angleRequest };

/**
 * Return a request for each row of a table; fields without a column and empty cells take the value of `base`.
 *
 * @throws {Error} naming the column or the cell that cannot be read
 */
export function casesOf(text, base, operation) {
  const lines = text.split(/\r?\n/).filter((line) => line.trim() && !line.startsWith("#"));
  const separator = ["\t", ";"].find((each) => lines[0]?.includes(each)) ?? ",";
  const [header, ...rows] = lines.map((line) => line.split(separator).map((cell) => cell.trim().replace(/^"(.*)"$/, "$1")));
  if (!rows.length) throw new Error("The table needs a header and a row for each case.");
  const paths = header.map((name) => pathOf(name, base));
  return rows.map((cells, i) => {
    if (cells.length !== header.length) throw new Error(`Case ${i + 1} has ${cells.length} cells, the header ${header.length}.`);
    const values = paths.reduce((given, path, column) => (cells[column] ? withCell(given, path, cells[column], i) : given), base);
    const { [ID]: id, ...rest } = values;
    return { ...REQUESTS[operation](withSphere(rest, rest)), ...(id && { [ID]: id }) };
  });
}

function pathOf(name, base) {
  const part = PARTS.find((each) => nodeAt(each + name, base));
  if (name === ID || part !== undefined) return name === ID ? ID : part + name;
  const words = name.toLowerCase().match(/[a-z]{3,}/g) ?? [];
  const alike = numericFields(base).filter(({ label, path }) => words.some((word) => `${label} ${path}`.toLowerCase().includes(word)));
  const hint = alike.length ? ` Did you mean ${alike.slice(0, 3).map(({ path }) => path).join(" or ")}?` : "";
  throw new Error(`Column "${name}" is not a field of a case.${hint}`);
}

function withCell(values, path, cell, i) {
  const value = path === ID ? cell : readParameter(path, cell, values);
  if (value === undefined) throw new Error(`Case ${i + 1}, ${path}: "${cell}" is not valid.`);
  return withValue(values, path, value);
}
