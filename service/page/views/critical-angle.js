// Critical angle: how it is found.

/** Show the view. */
export async function show(root, query) {}
