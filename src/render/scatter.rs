//! Measures of anything that draws directions: BSDFs, phase functions, warps.
//!
//! What draws directions by a density that it can tell is a [`Scatter`]; a grid of cells of equal solid angle then compares
//! how many directions fall into each with how many should. The integral over a cell is found by refining it until two
//! steps agree, so that narrow lobes are met without being told where they are. Knows nothing of surfaces in a scene.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use crate::math::statistics::{ChiSquareTest, chi_square_test};
use crate::math::stream::{Purpose, Stream};
use crate::math::{elementary, single, sphere};
use crate::render::bsdf::Transport;
use crate::render::bsdf::disney::Gtr1;
use crate::render::bsdf::measure::View;
use crate::render::bsdf::microfacet::Facets;
use crate::render::medium::phase::Phase;

/// Something that draws directions by a density that it can tell.
pub trait Scatter {
    /// Draws a direction; `None` where nothing is drawn. `choice` picks among lobes, `point` a direction.
    fn draw(&self, choice: f32, point: [f32; 2]) -> Option<Drawn>;

    /// Value (with the cosine, of a surface) and density per steradian.
    fn value_and_pdf(&self, direction: Vec3) -> (Vec3, f32);

    /// Whether directions lie below the plane z = 0 too.
    fn covers_sphere(&self) -> bool;
}

/// A direction that was drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drawn {
    /// Unit vector.
    pub direction: Vec3,
    /// Value over density.
    pub weight: Vec3,
    /// Whether it belongs to no density.
    pub is_delta: bool,
}

impl Scatter for View<'_> {
    fn draw(&self, choice: f32, point: [f32; 2]) -> Option<Drawn> {
        let sample = self.bsdf.sample(self.outgoing, choice, point, Transport::Energy)?;
        Some(Drawn { direction: sample.direction, weight: sample.weight, is_delta: sample.is_delta })
    }

    fn value_and_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        self.bsdf.evaluate_with_pdf(self.outgoing, direction, Transport::Energy)
    }

    fn covers_sphere(&self) -> bool {
        self.bsdf.is_transmissive()
    }
}

/// Maps of the unit square to directions, whose value is their density.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Warp {
    /// All directions alike.
    UniformSphere,
    /// By the cosine to +z, of a square laid on the disk without folds (Shirley and Chiu 1997).
    CosineHemisphere,
    /// By the cosine to +z, in polar coordinates (Malley).
    PolarCosineHemisphere,
    /// By D cos: all normals of facets.
    Normals(Facets),
    /// By D cos: the normals of the clear coat of `disney`.
    CoatNormals(Gtr1),
}

impl Scatter for Warp {
    fn draw(&self, _choice: f32, point: [f32; 2]) -> Option<Drawn> {
        let direction = match self {
            Self::UniformSphere => sphere::uniform_sphere(point.map(f64::from)).as_vec3().normalize(),
            Self::CosineHemisphere => Vec3::from_array(single::cosine_hemisphere(point)),
            Self::PolarCosineHemisphere => sphere::cosine_hemisphere(point.map(f64::from)).as_vec3().normalize(),
            Self::Normals(facets) => facets.sample(Vec3::Z, point),
            Self::CoatNormals(coat) => coat.sample(point),
        };
        Some(Drawn { direction, weight: Vec3::ONE, is_delta: false })
    }

    fn value_and_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        let pdf = match self {
            Self::UniformSphere => sphere::uniform_sphere_pdf() as f32,
            Self::CosineHemisphere | Self::PolarCosineHemisphere => sphere::cosine_hemisphere_pdf(f64::from(direction.z)) as f32,
            Self::Normals(facets) => facets.density(direction, 1.0) * direction.z.max(0.0),
            Self::CoatNormals(coat) => coat.density(direction) * direction.z.max(0.0),
        };
        (Vec3::splat(pdf), pdf)
    }

    fn covers_sphere(&self) -> bool {
        *self == Self::UniformSphere
    }
}

/// A phase function, seen from where light comes out of the medium: directions are those from which it came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scattering {
    /// The phase function.
    pub phase: Phase,
    /// Unit vector towards the viewer.
    pub outgoing: Vec3,
}

impl Scatter for Scattering {
    fn draw(&self, _choice: f32, point: [f32; 2]) -> Option<Drawn> {
        let direction = self.phase.sample(-self.outgoing, point);
        Some(Drawn { direction, weight: Vec3::ONE, is_delta: false })
    }

    fn value_and_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        let value = self.phase.value(-self.outgoing, direction);
        (Vec3::splat(value), value)
    }

    fn covers_sphere(&self) -> bool {
        true
    }
}

/// Cells of equal solid angle: rows in height from the pole +z, columns in azimuth from +x towards +y.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cells {
    /// Columns.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Whether they go on to the pole -z.
    pub is_whole: bool,
}

/// What lies in each cell, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Survey {
    /// The integral of the density.
    pub probability: Vec<f64>,
    /// The integral of the value, over all cells.
    pub albedo: DVec3,
}

/// Directions that were drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Count {
    /// How many in each cell, row by row; last, how many were none, or of a delta lobe.
    pub counts: Vec<u64>,
    /// The mean weight, delta lobes included.
    pub mean_weight: DVec3,
    /// Standard error of the mean over the channels.
    pub standard_error: f64,
}

impl Cells {
    /// About `rows` rows of cells, for what is to be measured.
    pub fn of(scatter: &impl Scatter, rows: usize) -> Self {
        let is_whole = scatter.covers_sphere();
        Self { columns: 2 * rows, rows, is_whole }
    }

    /// How many.
    pub fn count(&self) -> usize {
        self.columns * self.rows
    }

    /// z at the upper edge of a row, which may have a fraction.
    fn height(&self, row: f64) -> f64 {
        1.0 - row / self.rows as f64 * if self.is_whole { 2.0 } else { 1.0 }
    }

    /// The direction at a row and a column, which may have fractions.
    pub fn direction(&self, column: f64, row: f64) -> DVec3 {
        let z = self.height(row);
        let radius = (1.0 - z * z).max(0.0).sqrt();
        let (sine, cosine) = elementary::sin_cos(2.0 * PI * column / self.columns as f64);
        DVec3::new(radius * cosine, radius * sine, z)
    }

    fn index(&self, direction: DVec3) -> usize {
        let share = (1.0 - direction.z) / if self.is_whole { 2.0 } else { 1.0 };
        let row = ((share * self.rows as f64).max(0.0) as usize).min(self.rows - 1);
        let turn = elementary::atan2(direction.y, direction.x).rem_euclid(2.0 * PI) / (2.0 * PI);
        row * self.columns + ((turn * self.columns as f64) as usize).min(self.columns - 1)
    }

    /// Solid angle of a cell.
    fn solid_angle(&self) -> f64 {
        let whole = if self.is_whole { 4.0 * PI } else { 2.0 * PI };
        whole / self.count() as f64
    }

    /// Integrates density and value over every cell.
    pub fn survey(&self, scatter: &impl Scatter) -> Survey {
        let mut probability = Vec::with_capacity(self.count());
        let mut albedo = DVec3::ZERO;
        for index in 0..self.count() {
            let (value, share) = self.integral(scatter, index % self.columns, index / self.columns);
            probability.push(share);
            albedo += value;
        }
        Survey { probability, albedo }
    }

    /// Integrals of value and density over a cell: finer grids until the last two agree.
    fn integral(&self, scatter: &impl Scatter, column: usize, row: usize) -> (DVec3, f64) {
        const COARSEST: usize = 4;
        const FINEST: usize = 256;
        let mut side = COARSEST;
        let mut last = self.midpoints(scatter, column, row, side);
        while side < FINEST {
            side *= 2;
            let next = self.midpoints(scatter, column, row, side);
            let change = (next.0 - last.0).abs().max_element().max((next.1 - last.1).abs());
            let size = next.0.abs().max_element().max(next.1);
            last = next;
            // What a cell has beyond a ten-millionth of all hardly matters.
            if change <= 1e-3 * size + 1e-7 {
                break;
            }
        }
        last
    }

    /// The midpoint rule on `side`² points of a cell.
    fn midpoints(&self, scatter: &impl Scatter, column: usize, row: usize, side: usize) -> (DVec3, f64) {
        let part = |whole: usize, k: usize| whole as f64 + (k as f64 + 0.5) / side as f64;
        let (mut value, mut pdf) = (DVec3::ZERO, 0.0);
        for k in 0..side * side {
            let direction = self.direction(part(column, k % side), part(row, k / side));
            let (value_there, pdf_there) = scatter.value_and_pdf(direction.as_vec3());
            value += value_there.as_dvec3();
            pdf += f64::from(pdf_there);
        }
        let each = self.solid_angle() / (side * side) as f64;
        (value * each, pdf * each)
    }

    /// Draws that many directions and counts them.
    pub fn count_drawn(&self, scatter: &impl Scatter, draws: u32, seed: u64) -> Count {
        let stream = Stream::new(seed, Purpose::Test);
        let mut counts = vec![0; self.count() + 1];
        let (mut sum, mut squares) = (DVec3::ZERO, 0.0);
        for index in 0..u64::from(draws) {
            let mut numbers = stream.generator(index);
            let mut uniform = || (numbers.uniform() as f32).min(1.0 - f32::EPSILON / 2.0);
            let (choice, point) = (uniform(), [uniform(), uniform()]);
            let drawn = scatter.draw(choice, point);
            let weight = drawn.map_or(DVec3::ZERO, |drawn| drawn.weight.as_dvec3());
            let mean = weight.element_sum() / 3.0;
            sum += weight;
            squares += mean * mean;
            let smooth = drawn.filter(|drawn| !drawn.is_delta);
            counts[smooth.map_or(self.count(), |drawn| self.index(drawn.direction.as_dvec3()))] += 1;
        }
        let n = f64::from(draws);
        let mean = sum.element_sum() / 3.0 / n;
        let standard_error = ((squares / n - mean * mean).max(0.0) / (n - 1.0).max(1.0)).sqrt();
        Count { counts, mean_weight: sum / n, standard_error }
    }
}

impl Survey {
    /// The integral of the density: one, less what is drawn of delta lobes and not at all.
    pub fn drawn(&self) -> f64 {
        self.probability.iter().sum()
    }

    /// Pearson's test of the counts against the probabilities, with the failures as one more cell.
    pub fn test(&self, count: &Count) -> ChiSquareTest {
        let draws = count.counts.iter().sum::<u64>() as f64;
        let failing = (1.0 - self.drawn()).max(0.0);
        // A cell that lies between the points of the quadrature is not impossible, only rare.
        let expected: Vec<f64> = self.probability.iter().chain([&failing]).map(|share| share.max(1e-9) * draws).collect();
        chi_square_test(&count.counts, &expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::bsdf::DirectionSampling;
    use crate::render::bsdf::material::Material;
    use crate::render::bsdf::microfacet::{FacetDistribution, Masking, NormalSampling};
    use crate::render::medium::phase::{HenyeyGreensteinParameters, PhaseDescription};
    use crate::render::texture::TexturePoint;

    fn view(text: &str, degrees: f64) -> View<'static> {
        let json: serde_json::Value = serde_yaml::from_str(text).unwrap();
        let material = Material::new(&serde_json::from_value(json).unwrap(), DirectionSampling::Bsdf).unwrap();
        View::at_degrees(Box::leak(Box::new(material)).at(&TexturePoint::ANYWHERE), degrees)
    }

    fn assert_sound(name: &str, scatter: &impl Scatter, albedo: f64) {
        let cells = Cells::of(scatter, 12);
        let (survey, count) = (cells.survey(scatter), cells.count_drawn(scatter, 20_000, 3));
        let test = survey.test(&count);
        // Thirteen tests, once in a thousand sets of seeds.
        assert!(test.p_value > 1e-4 && test.degrees_of_freedom > 10, "{name}: {test:?}");
        let mean = count.mean_weight.element_sum() / 3.0;
        let found = survey.albedo.element_sum() / 3.0;
        assert!((found - albedo).abs() < 2e-3, "{name}: {found} instead of {albedo}");
        assert!((found - mean).abs() < 4.0 * count.standard_error + 2e-3, "{name}: {found} and {mean}");
    }

    #[test]
    fn warps_and_bsdfs_are_drawn_by_their_density() {
        assert_sound("uniform", &Warp::UniformSphere, 1.0);
        assert_sound("cosine", &Warp::CosineHemisphere, 1.0);
        assert_sound("polar cosine", &Warp::PolarCosineHemisphere, 1.0);
        assert_sound("coat", &Warp::CoatNormals(Gtr1::new(0.3)), 1.0);
        for (name, distribution) in [("GGX", FacetDistribution::Ggx), ("Beckmann", FacetDistribution::Beckmann)] {
            let facets = Facets { distribution, masking: Masking::Correlated, sampling: NormalSampling::AllNormals, alpha: 0.4 };
            assert_sound(name, &Warp::Normals(facets), 1.0);
        }
        for g in [0.0, 0.6, -0.8] {
            let phase = PhaseDescription::HenyeyGreenstein(HenyeyGreensteinParameters { g }).compiled();
            assert_sound(&format!("g = {g}"), &Scattering { phase, outgoing: Vec3::new(0.6, 0.0, -0.8) }, 1.0);
        }
        assert_sound("diffuse", &view("diffuse: { reflectance: 0.6 }", 45.0), 0.6);
        // Section 8 of the specification.
        assert_sound("metal", &view("rough-conductor: { metal: ideal, alpha: 0.25 }", 45.0), 0.8862);
        assert_sound("glass", &view("rough-dielectric: { alpha: 0.5 }", 45.0), 0.931);
        assert_sound("narrow", &view("rough-conductor: { metal: ideal, alpha: 0.1 }", 45.0), 0.9817);
    }

    #[test]
    fn a_wrong_density_is_told() {
        /// Draws by the cosine and says uniform.
        struct Wrong;

        impl Scatter for Wrong {
            fn draw(&self, choice: f32, point: [f32; 2]) -> Option<Drawn> {
                Warp::CosineHemisphere.draw(choice, point)
            }

            fn value_and_pdf(&self, _: Vec3) -> (Vec3, f32) {
                (Vec3::splat(0.5 / std::f32::consts::PI), 0.5 / std::f32::consts::PI)
            }

            fn covers_sphere(&self) -> bool {
                false
            }
        }
        let cells = Cells::of(&Wrong, 12);
        assert!(cells.survey(&Wrong).test(&cells.count_drawn(&Wrong, 5000, 1)).p_value < 1e-6);
    }

    #[test]
    fn the_middle_of_a_cell_lies_in_it() {
        for cells in [Cells { columns: 10, rows: 5, is_whole: true }, Cells { columns: 8, rows: 3, is_whole: false }] {
            for index in 0..cells.count() {
                let (column, row) = (index % cells.columns, index / cells.columns);
                assert_eq!(cells.index(cells.direction(column as f64 + 0.5, row as f64 + 0.5)), index);
            }
        }
    }
}
