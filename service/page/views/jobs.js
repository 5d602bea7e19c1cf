// Jobs: what was asked for in bulk.

/** Show the view. */
export async function show(root, query) {}
