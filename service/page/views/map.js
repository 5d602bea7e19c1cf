// Map: the answer over two fields.

/** Show the view. */
export async function show(root, query) {}
