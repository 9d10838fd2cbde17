// Constants shared by shaders and the sorter.

/** Gaussians per texture row. */
export const ROW = 1024;

/** Near plane of views that state none, scene units. */
export const NEAR = 0.2;
