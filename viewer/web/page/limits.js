// What the graphics card and the sorter must agree on.

/** Gaussians in a row of a texture. */
export const ROW = 1024;

/** How far ahead of the camera what is seen begins, scene units. */
export const NEAR = 0.2;
