//! Rounded pieces of a mesh: ellipsoids and tapered capsules.

use std::f32::consts::{FRAC_PI_2, TAU};

use glam::Vec3;

/// Corners of a ring around a piece.
const AROUND: u16 = 10;
/// Rings between the two ends of a piece.
const RINGS: u16 = 6;

/// A rounded piece from one end to the other, of which each end has its own width and depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Blob {
    /// Bone that moves it.
    pub(crate) bone: usize,
    pub(crate) from: Vec3,
    pub(crate) to: Vec3,
    /// Direction of the width.
    pub(crate) side: Vec3,
    /// Half width and half depth at both ends, metres.
    pub(crate) radii: [[f32; 2]; 2],
}

/// Triangles whose corners each follow one bone.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mesh {
    pub(crate) positions: Vec<Vec3>,
    pub(crate) normals: Vec<Vec3>,
    pub(crate) bones: Vec<u8>,
    pub(crate) triangles: Vec<[u16; 3]>,
}

impl Mesh {
    /// Adds a piece, seen from outside counter-clockwise.
    pub(crate) fn push(&mut self, blob: &Blob) {
        let first = self.positions.len() as u16;
        let rings = RINGS + 2;
        for ring in 0..rings {
            for corner in 0..AROUND {
                let (position, normal) = blob.surface(
                    f32::from(ring) / f32::from(rings - 1),
                    f32::from(corner) / f32::from(AROUND),
                );
                self.positions.push(position);
                self.normals.push(normal);
                self.bones.push(blob.bone as u8);
            }
        }
        let at = |ring: u16, corner: u16| first + ring * AROUND + corner % AROUND;
        for ring in 0..rings - 1 {
            for corner in 0..AROUND {
                let [a, b] = [at(ring, corner), at(ring, corner + 1)];
                let [c, d] = [at(ring + 1, corner), at(ring + 1, corner + 1)];
                // The ends are points: one of the two triangles has no area there.
                if ring > 0 {
                    self.triangles.push([a, c, b]);
                }
                if ring < rings - 2 {
                    self.triangles.push([b, c, d]);
                }
            }
        }
    }
}

impl Blob {
    /// Returns position and normal at a part of the way from end to end and of the way around.
    fn surface(&self, along: f32, around: f32) -> (Vec3, Vec3) {
        let axis = self.to - self.from;
        let up = axis.normalize_or(Vec3::Y);
        let across = (self.side - up * self.side.dot(up)).normalize_or(up.any_orthonormal_vector());
        let depth = across.cross(up);
        // Rings are close at the round ends: their angles are even, those of a sphere.
        let (sin, cos) = (TAU * 0.5 * along - FRAC_PI_2).sin_cos();
        let part = 0.5 * (1.0 + sin);
        let [width, thick] = [0, 1].map(|axis| {
            let [from, to] = [self.radii[0][axis], self.radii[1][axis]];
            // Fuller than an ellipsoid, rounder than a cylinder.
            (from + (to - from) * part) * cos.max(0.0).sqrt()
        });
        let (around_sin, around_cos) = (TAU * around).sin_cos();
        let position = self.from
            + up * (part * axis.length())
            + across * (width * around_cos)
            + depth * (thick * around_sin);
        let half = [0, 1].map(|axis| 0.5 * (self.radii[0][axis] + self.radii[1][axis]).max(1e-4));
        let flat = cos.max(0.0).sqrt();
        let normal = up * (sin * 2.0 / axis.length().max(1e-3))
            + across * (flat * around_cos / half[0])
            + depth * (flat * around_sin / half[1]);
        (position, normal.normalize_or(up * sin.signum()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_is_closed_and_faces_outward() {
        let mut mesh = Mesh::default();
        mesh.push(&Blob {
            bone: 3,
            from: Vec3::new(0.0, 1.0, 0.0),
            to: Vec3::new(0.4, 1.0, 0.1),
            side: Vec3::Y,
            radii: [[0.05, 0.04], [0.03, 0.03]],
        });
        let middle = Vec3::new(0.2, 1.0, 0.05);
        let mut edges = std::collections::HashMap::new();
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|corner| mesh.positions[usize::from(corner)]);
            let normal = (b - a).cross(c - a);
            assert!(normal.length() > 1e-9 && normal.dot(a - middle) > 0.0, "{triangle:?}");
            // Corners of the end points coincide: edges are compared by their places.
            let key = |v: Vec3| (v * 1e5).round().as_ivec3();
            for [a, b] in [[a, b], [b, c], [c, a]] {
                *edges.entry((key(a), key(b))).or_insert(0) += 1;
            }
        }
        assert!(edges.iter().all(|((a, b), _)| edges.contains_key(&(*b, *a))), "a hole");
        for (position, normal) in mesh.positions.iter().zip(&mesh.normals) {
            assert!((normal.length() - 1.0).abs() < 1e-5);
            assert!(normal.dot(position - middle) > -1e-3, "{position} {normal}");
        }
        assert!(mesh.bones.iter().all(|&bone| bone == 3));
    }
}
