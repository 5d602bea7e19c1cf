// Explore: one strike, as its fields are changed.

/** Show the view. */
export async function show(root, query) {}
