// The form of a case.

/**
 * Build the form.
 *
 * @param {HTMLElement} root
 * @param {{case: object, onChange: (values: object, path: string) => void, include?: string[]}} options `onChange` is
 *   told of a case only if all its fields are in their bounds; `include` names the groups of fields.js, all if none
 * @returns {{setCase: (values: object) => void, showProblems: (problem: Problem) => void, currentCase: () => object}}
 */
export function buildForm(root, options) {}
