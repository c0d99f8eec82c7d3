/** A function of space whose zero is a surface: negative inside. */
export type Field = (x: number, y: number, z: number) => number;

export interface Mesh {
  positions: Float32Array;
  normals: Float32Array;
  indices: Uint32Array;
}

/** Cells of a block along each axis. */
const BLOCK = 6;

/** Meshes the zero of a distance field in a box (naive surface nets), with exact normals. */
export function mesh(field: Field, from: number[], to: number[], cell: number): Mesh {
  const size = from.map((start, axis) => Math.ceil((to[axis] - start) / cell) + 1);
  const values = sample(field, from, size, cell);
  const [nx, ny] = size;
  const step = [1, nx, nx * ny];
  const vertices: number[] = [];
  const point = [0, 0, 0];
  const numbers = new Int32Array(values.length).fill(-1);
  for (let z = 0; z < size[2] - 1; z++)
    for (let y = 0; y < ny - 1; y++)
      for (let x = 0; x < nx - 1; x++) {
        const at = x + y * step[1] + z * step[2];
        if (!centreOfCrossings(values, at, step, point)) continue;
        numbers[at] = vertices.length / 3;
        vertices.push(
          from[0] + (x + point[0]) * cell,
          from[1] + (y + point[1]) * cell,
          from[2] + (z + point[2]) * cell,
        );
      }
  const indices: number[] = [];
  for (let z = 1; z < size[2] - 1; z++)
    for (let y = 1; y < ny - 1; y++)
      for (let x = 1; x < nx - 1; x++) {
        const at = x + y * step[1] + z * step[2];
        for (let axis = 0; axis < 3; axis++) face(values, numbers, at, axis, step, indices);
      }
  const positions = Float32Array.from(vertices);
  return { positions, normals: settle(field, positions), indices: Uint32Array.from(indices) };
}

/** Samples the field on the grid; far from the surface once per block. */
function sample(field: Field, from: number[], size: number[], cell: number): Float32Array {
  const [nx, ny, nz] = size;
  const values = new Float32Array(nx * ny * nz);
  const reach = (BLOCK * cell * Math.sqrt(3)) / 2 + cell;
  for (let bz = 0; bz < nz; bz += BLOCK)
    for (let by = 0; by < ny; by += BLOCK)
      for (let bx = 0; bx < nx; bx += BLOCK) {
        const half = (BLOCK - 1) / 2;
        const middle = field(
          from[0] + (bx + half) * cell,
          from[1] + (by + half) * cell,
          from[2] + (bz + half) * cell,
        );
        // Stretched parts understate distances: with the factor no surface is missed.
        const far = Math.abs(middle) > reach * 1.3;
        for (let z = bz; z < Math.min(bz + BLOCK, nz); z++)
          for (let y = by; y < Math.min(by + BLOCK, ny); y++)
            for (let x = bx; x < Math.min(bx + BLOCK, nx); x++)
              values[x + y * nx + z * nx * ny] = far
                ? middle
                : field(from[0] + x * cell, from[1] + y * cell, from[2] + z * cell);
      }
  return values;
}

/** Writes the mean of the crossings on the edges of a cell, in cells; false if there are none. */
function centreOfCrossings(
  values: Float32Array,
  at: number,
  step: number[],
  out: number[],
): boolean {
  out[0] = out[1] = out[2] = 0;
  let count = 0;
  for (let corner = 0; corner < 8; corner++) {
    const a = values[at + offset(corner, step)];
    for (let axis = 0; axis < 3; axis++) {
      if (corner & (1 << axis)) continue;
      const b = values[at + offset(corner | (1 << axis), step)];
      if (a < 0 === b < 0) continue;
      for (let k = 0; k < 3; k++) out[k] += (corner >> k) & 1;
      out[axis] += a / (a - b);
      count++;
    }
  }
  for (let k = 0; k < 3; k++) out[k] /= count || 1;
  return count > 0;
}

function offset(corner: number, step: number[]): number {
  return (corner & 1) * step[0] + ((corner >> 1) & 1) * step[1] + ((corner >> 2) & 1) * step[2];
}

/** Adds the two triangles around a grid edge that the surface crosses. */
function face(
  values: Float32Array,
  numbers: Int32Array,
  at: number,
  axis: number,
  step: number[],
  indices: number[],
): void {
  const inside = values[at] < 0;
  if (inside === values[at + step[axis]] < 0) return;
  const u = step[(axis + 1) % 3];
  const v = step[(axis + 2) % 3];
  const [a, b, c, d] = [numbers[at - u - v], numbers[at - v], numbers[at], numbers[at - u]];
  if (inside) indices.push(a, b, c, a, c, d);
  else indices.push(a, c, b, a, d, c);
}

/** Moves vertices onto the surface and returns its normals there. */
function settle(field: Field, positions: Float32Array): Float32Array {
  const normals = new Float32Array(positions.length);
  const e = 1e-3;
  for (let i = 0; i < positions.length; i += 3) {
    for (let round = 0; round < 2; round++) {
      const x = positions[i];
      const y = positions[i + 1];
      const z = positions[i + 2];
      const gx = field(x + e, y, z) - field(x - e, y, z);
      const gy = field(x, y + e, z) - field(x, y - e, z);
      const gz = field(x, y, z + e) - field(x, y, z - e);
      const length = Math.sqrt(gx * gx + gy * gy + gz * gz) || 1;
      const value = field(x, y, z) / length;
      normals[i] = gx / length;
      normals[i + 1] = gy / length;
      normals[i + 2] = gz / length;
      positions[i] -= value * gx;
      positions[i + 1] -= value * gy;
      positions[i + 2] -= value * gz;
    }
  }
  return normals;
}
