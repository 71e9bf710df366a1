//! Lighting of surfaces, baked into vertex colours.
//!
//! The viewer lights a mesh from two nearly opposite directions, with little more than ambient light in between, which
//! leaves a dark band around every body. Surfaces therefore also have lit vertex colours, and the views of the layout
//! draw these, unlit by the viewer. All other views use the surface's original colours and normals.

use std::sync::{Arc, LazyLock};

use glam::{DQuat, DVec3};

use super::{
    blueprint::Mapping,
    contract::{LIT, UNLIT},
    extract::Float3,
    palette::Rgb,
};
use crate::{
    observe::Schema,
    sdk::{
        AnyValues,
        arrow::{
            array::{FixedSizeListArray, Float32Array},
            datatypes::{DataType, Field},
        },
    },
};

/// Visualizer sources of a surface that the viewer does not light.
pub const NO_LIGHT: Mapping = Mapping { target: "Mesh3D:vertex_normals", source: UNLIT.0 };
/// Visualizer sources of a surface with lit colours.
pub const COLORS: Mapping = Mapping { target: "Mesh3D:vertex_colors", source: LIT.0 };

/// The normal that receives no light. The viewer repeats it for all vertices.
pub fn unlit() -> AnyValues {
    let item = Field::new("item", DataType::Float32, false);
    let zero = FixedSizeListArray::new(item.into(), 3, Arc::new(Float32Array::from(vec![0.0; 3])), None);
    AnyValues::default().with_component_from_data(UNLIT.0, Arc::new(zero))
}

/// A large soft light, above and beside the initial camera.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// Direction towards the light [unit vector].
    towards: [f32; 3],
}

impl Light {
    /// The light in world axes.
    pub fn in_world(schema: &Schema) -> Light {
        Light::in_body(schema, DQuat::IDENTITY)
    }

    /// The light in body axes.
    pub fn in_body(schema: &Schema, rotation: DQuat) -> Light {
        let towards = DVec3::new(-0.68, -0.36, 0.64).normalize();
        Light { towards: ((schema.upright() * rotation).conjugate() * towards).as_vec3().to_array() }
    }

    /// White, shaded for a surface with this unit normal, as packed RGBA.
    pub fn white(self, normal: Float3) -> u32 {
        let shade = u32::from(self.shade(normal));
        shade << 24 | shade << 16 | shade << 8 | 0xFF
    }

    /// A colour, shaded for a surface with this unit normal, as packed RGBA.
    pub fn on(self, rgb: Rgb, normal: Float3) -> u32 {
        let shade = u32::from(self.shade(normal));
        let [r, g, b] = rgb.map(|channel| (u32::from(channel) * shade + 127) / 255);
        r << 24 | g << 16 | b << 8 | 0xFF
    }

    /// Shading factor in the encoding of colours, from 0 to 255.
    fn shade(self, normal: Float3) -> u8 {
        static SHADES: LazyLock<[u8; 256]> = LazyLock::new(|| {
            std::array::from_fn(|i| {
                /// Shading of a surface that faces away.
                const AMBIENT: f64 = 0.09;
                // wrap lighting: a surface without any direct light would look flat
                let facing = libm::pow(i as f64 / 255.0, 1.7);
                let linear = AMBIENT + (1.0 - AMBIENT) * facing;
                (255.0 * libm::pow(linear, 1.0 / 2.2)).round() as u8
            })
        });
        let [x, y, z] = normal;
        let [lx, ly, lz] = self.towards;
        let facing = x * lx + y * ly + z * lz;
        SHADES[(127.5 * facing + 128.0).clamp(0.0, 255.0) as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shading_falls_off_monotonically_with_the_angle() {
        let light = Light::in_world(&Schema::default());
        let towards = DVec3::from_array(light.towards.map(f64::from));
        let across = towards.any_orthonormal_vector();
        let shade = |degrees: u32| {
            let angle = f64::from(degrees).to_radians();
            light.shade((angle.cos() * towards + angle.sin() * across).as_vec3().to_array())
        };
        assert_eq!(shade(0), 255);
        let shades: Vec<u8> = (0..=180).map(shade).collect();
        assert!(shades.is_sorted_by(|a, b| a >= b), "{shades:?}");
        assert!(shades[180] > 80, "the far side is visible: {}", shades[180]);
        for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            light.shade([odd; 3]); // does not panic
        }
    }

    #[test]
    fn the_light_does_not_rotate_with_a_body() {
        let rotation = DQuat::from_rotation_x(1.0) * DQuat::from_rotation_z(2.0);
        for normal in [DVec3::X, DVec3::Y, DVec3::NEG_Z, DVec3::ONE.normalize()] {
            let in_world = Light::in_world(&Schema::default()).white((rotation * normal).as_vec3().to_array());
            let in_body = Light::in_body(&Schema::default(), rotation).white(normal.as_vec3().to_array());
            assert!((in_world >> 24).abs_diff(in_body >> 24) <= 1, "{in_world:x} {in_body:x}");
        }
    }

    #[test]
    fn each_color_channel_is_shaded() {
        let normal = DVec3::new(-0.68, -0.36, 0.64).normalize().as_vec3().to_array();
        assert_eq!(Light::in_world(&Schema::default()).on([10, 20, 255], normal), 0x0A14_FFFF);
        assert_eq!(Light::in_world(&Schema::default()).white(normal), u32::MAX);
    }
}
