// Examples, bounds, choices and display names of fields, fetched from the service, so that the page does not repeat them.

import { request } from "./service.js";

const TAGS = ["shape", "model"];
const ROOTS = { search: "CriticalAngleRequest", sampling: "CriticalAngleUncertaintyRequest" };

let schemas;
/** Display names: `choices` by field and value, worded for use inside a sentence; `quantities` by path; `outcomes`, `formulas` and others. */
export let names;
/** Usual distributions of the inputs that scatter, by field, without the parameter that the value of the case provides. */
export let usualScatter;

/** Fetch the contract, on which every other function of this module depends. */
export async function loadContract() {
  if (!schemas) ({ schemas, usual_scatter: usualScatter, names } = (await request("page/contract.json")).data);
}

/**
 * Return the paper's case at 45°: the first example of a trajectory, with its models named explicitly.
 *
 * A case of the page combines a body for `/trajectory` and one for `/cra`: it has both `impact.oblique_angle_deg` and
 * `search`, which `trajectoryRequest` and `angleRequest` of case.js separate.
 */
export function paperCase() {
  return structuredClone({
    ...schemas.TrajectoryRequest.examples[0],
    resistance: { strength_factor: { model: "obliquity_polynomial" }, free_surface: { model: "elastic_plastic" } },
    search: { method: schemas.Search.properties.method.default },
  });
}

/** Return the first example of a variant, such as the `conical` one at `projectile.nose`. */
export function exampleOf(path, tag) {
  const { discriminator } = nodeAt(path, {});
  return structuredClone(resolved({ $ref: discriminator.mapping[tag] }).examples[0]);
}

/** Return whether a part of a case has a variant of this name. */
export function isVariant(path, tag) {
  return Object.hasOwn(nodeAt(path, {})?.discriminator?.mapping ?? {}, tag);
}

/** Return the required fields of a variant from its first example, except shots, which only the user can give. */
export function requiredOf(path, tag) {
  const { required = [] } = resolved({ $ref: nodeAt(path, {}).discriminator.mapping[tag] });
  return Object.fromEntries(Object.entries(exampleOf(path, tag)).filter(([name]) => required.includes(name) && name !== "shots"));
}

/**
 * Return the schema of the field at a dotted path; the variants that a case has decide which fields there are.
 *
 * @returns {{type: string, minimum?: number, maximum?: number, exclusiveMinimum?: number, exclusiveMaximum?: number,
 *   default?: any, description?: string, enum?: string[]}|undefined} undefined if the case has no such field
 */
export function nodeAt(path, values) {
  const names = path.split(".");
  const root = ROOTS[names[0]] ?? "TrajectoryRequest";
  let node = schemas[root];
  let given = values;
  for (const name of names) {
    node = variantOf(node, given)?.properties?.[name];
    if (!node) return undefined;
    node = { ...resolved(node), ...node };
    given = given?.[name];
  }
  return node;
}

/** Return the field that names the variant of an object, `shape` or `model`; undefined if it has neither. */
export function tagOf(part) {
  return TAGS.find((tag) => tag in part);
}

function resolved(node) {
  return node.$ref ? resolved(schemas[node.$ref.split("/").at(-1)]) : node;
}

function variantOf(node, given) {
  if (!node.discriminator) return node;
  const { propertyName, mapping } = node.discriminator;
  const name = mapping[given?.[propertyName]];
  return name && resolved({ $ref: name });
}
