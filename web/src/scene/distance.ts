import type { Body, Part } from './body';

/** Width over which parts of a limb, and limbs and trunk, flow into each other, in metres. */
const BLEND = 0.018;
const JOIN = 0.04;

/** Distance of a point to a part in metres, negative inside. Makes no objects: it runs very often. */
export function partDistance(part: Part, x: number, y: number, z: number): number {
  const { a, b, ra, rb, width, depth } = part;
  // A stretched cross-section is a round one in stretched space.
  const middleX = (a[0] + b[0]) / 2;
  const middleZ = (a[2] + b[2]) / 2;
  const ax = (a[0] - middleX) / width;
  const az = (a[2] - middleZ) / depth;
  const dx = (b[0] - middleX) / width - ax;
  const dy = b[1] - a[1];
  const dz = (b[2] - middleZ) / depth - az;
  const px = (x - middleX) / width - ax;
  const py = y - a[1];
  const pz = (z - middleZ) / depth - az;
  const length = dx * dx + dy * dy + dz * dz;
  const along = length > 0 ? Math.min(Math.max((px * dx + py * dy + pz * dz) / length, 0), 1) : 0;
  const ex = px - dx * along;
  const ey = py - dy * along;
  const ez = pz - dz * along;
  const scale = Math.min(width, depth, 1);
  return (Math.sqrt(ex * ex + ey * ey + ez * ez) - (ra + (rb - ra) * along)) * scale;
}

/** Distance to the whole body: limbs flow into the trunk, but not into each other. */
export function bodyDistance(body: Body, x: number, y: number, z: number): number {
  const trunk = union(body.trunk, x, y, z, JOIN);
  let nearest = trunk;
  for (const limb of body.limbs) {
    nearest = Math.min(nearest, smooth(trunk, union(limb, x, y, z), JOIN));
  }
  // Flat soles.
  return Math.max(nearest, body.floor - y);
}

function union(parts: Part[], x: number, y: number, z: number, blend = BLEND): number {
  let distance = Infinity;
  for (const part of parts) distance = smooth(distance, partDistance(part, x, y, z), blend);
  return distance;
}

/** Polynomial smooth minimum (Quilez). */
function smooth(a: number, b: number, width: number): number {
  const h = Math.max(width - Math.abs(a - b), 0) / width;
  return Math.min(a, b) - (h * h * width) / 4;
}
