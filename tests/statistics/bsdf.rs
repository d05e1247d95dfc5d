//! Drawing at surfaces against density, and mean weights against quadrature, for every kind of BSDF.
//!
//! Expected counts come from a quadrature over slopes of facets in double precision that shares nothing with the
//! drawing but the density; draws that fail, and delta lobes, are one cell more.

use glam::Vec3;
use pipeline::math::statistics::{chi_square_test, normal_cdf};
use pipeline::math::stream::{Purpose, Stream};
use pipeline::render::bsdf::material::Material;
use pipeline::render::bsdf::measure::{EXAMPLES, View};
use pipeline::render::bsdf::{Bsdf, BsdfDescription, DirectionSampling, Transport};
use pipeline::render::texture::TexturePoint;

use crate::shared::Family;

/// Draws of a view.
const COUNT: u32 = 1_000_000;
/// Steps of the quadrature.
const RESOLUTION: u32 = 1000;
/// Tests of this module that can fail by chance, at most; together they do so once in a thousand seeds.
const TESTS: Family = Family(400);

fn bsdf(text: &str, directions: DirectionSampling) -> Bsdf<'static> {
    let json: serde_json::Value = serde_yaml::from_str(text).unwrap();
    let description: BsdfDescription = serde_json::from_value(json).unwrap();
    let material = Material::new(&description, directions).unwrap();
    Box::leak(Box::new(material)).at(&TexturePoint::ANYWHERE)
}

fn view(text: &str, degrees: f64) -> View<'static> {
    View::at_degrees(bsdf(text, DirectionSampling::Bsdf), degrees)
}

/// From the front, and from behind where light passes.
fn angles(bsdf: &Bsdf<'_>) -> &'static [f64] {
    if bsdf.is_transmissive() { &[0.0, 45.0, 80.0, 88.0, 100.0, 135.0, 180.0] } else { &[0.0, 45.0, 80.0, 88.0] }
}

fn views(directions: DirectionSampling) -> impl Iterator<Item = (String, View<'static>)> {
    EXAMPLES.iter().map(move |text| (text, bsdf(text, directions))).filter(|(_, bsdf)| !bsdf.is_delta()).flat_map(|(text, bsdf)| {
        angles(&bsdf).iter().map(move |&degrees| (format!("{text} at {degrees}"), View::at_degrees(bsdf, degrees)))
    })
}

/// Less than ninety tests.
#[test]
fn drawn_directions_follow_their_density() {
    for (seed, (name, view)) in (0..).zip(views(DirectionSampling::Bsdf)) {
        TESTS.assert_plausible(&name, view.chi_square(COUNT, seed, RESOLUTION).p_value);
    }
}

/// Less than ninety tests.
#[test]
fn directions_drawn_by_the_cosine_follow_the_cosine() {
    for (seed, (name, view)) in (1000..).zip(views(DirectionSampling::Cosine)) {
        // A draw of value zero fails; its share is not known beforehand, so those cells are compared that are lit.
        let counts = view.counts(COUNT / 4, seed);
        let expected = view.expectations(COUNT / 4, RESOLUTION / 2);
        let is_cut = |(count, expected): (&u64, &f64)| (*count as f64) < 0.5 * expected;
        let lit: Vec<bool> = counts.iter().zip(&expected).map(|pair| !is_cut(pair)).collect();
        let all_lit = lit.iter().rev().skip(1).all(|lit| *lit);
        if all_lit {
            TESTS.assert_plausible(&name, chi_square_test(&counts, &expected).p_value);
        }
    }
}

/// Two-sided p-value of a mean weight against the directional albedo by quadrature.
fn albedo_p_value(drawn: &View, exact: &View, seed: u64) -> f64 {
    let (mean, error) = drawn.mean_weight(COUNT, seed, Transport::Energy);
    let albedo = exact.directional_albedo(RESOLUTION, Transport::Energy).element_sum() / 3.0;
    // The quadrature and single precision err by a few parts in a hundred thousand.
    2.0 * normal_cdf(-((mean - albedo).abs() - 3e-5).max(0.0) / error)
}

/// Less than ninety tests. Plastic has a delta lobe beside what the quadrature sees, and a closed form in `laws`.
#[test]
fn mean_weights_are_the_integrals_of_values() {
    for (seed, (name, view)) in
        (2000..).zip(views(DirectionSampling::Bsdf)).filter(|(_, (name, _))| !name.contains("plastic") && !name.contains("mirror"))
    {
        let (mean, error) = view.mean_weight(1000, seed, Transport::Energy);
        if error > 1e-6 * mean {
            TESTS.assert_plausible(&name, albedo_p_value(&view, &view, seed));
        }
    }
}

/// What comes of a wrong roughness, distribution, way of drawing, index or side.
#[test]
fn wrong_densities_are_noticed() {
    let gold = "rough-conductor: { metal: gold, alpha: 0.25 }";
    let controls = [
        ("one percent of roughness", "rough-conductor: { metal: gold, alpha: 0.2525 }", gold, 45.0),
        ("the other distribution", "rough-conductor: { metal: gold, alpha: 0.25, distribution: beckmann }", gold, 45.0),
        ("all normals for visible ones", "rough-conductor: { metal: gold, alpha: 0.25, sampling: all-normals }", gold, 45.0),
        (
            "two percent of a small roughness",
            "rough-conductor: { alpha: 0.0051, metal: gold }",
            "rough-conductor: { alpha: 0.005, metal: gold }",
            45.0,
        ),
        ("an index", "rough-dielectric: { eta: 1.51, alpha: 0.1 }", "rough-dielectric: { eta: 1.5, alpha: 0.1 }", 45.0),
        ("an index from inside", "rough-dielectric: { eta: 1.51, alpha: 0.1 }", "rough-dielectric: { eta: 1.5, alpha: 0.1 }", 150.0),
        ("Schlick's share", "rough-dielectric: { alpha: 0.1, fresnel: schlick }", "rough-dielectric: { alpha: 0.1 }", 45.0),
        ("a coat", "plastic: { eta: 1.52 }", "plastic: { eta: 1.5 }", 60.0),
    ];
    for (what, drawn, told, degrees) in controls {
        let (drawn, told) = (view(drawn, degrees), view(told, degrees));
        TESTS.assert_plausible(what, drawn.chi_square(4 * COUNT, 5, RESOLUTION).p_value);
        let wrong = chi_square_test(&told.counts_of(&drawn, 4 * COUNT, 5), &told.expectations(4 * COUNT, RESOLUTION));
        TESTS.assert_refused(what, wrong.p_value);
    }
}

#[test]
fn a_mirrored_lobe_a_scaled_density_and_forgotten_failures_are_noticed() {
    let right = view("rough-conductor: { metal: gold, alpha: 0.5 }", 45.0);
    let counts = right.counts(4 * COUNT, 6);
    let expected = right.expectations(4 * COUNT, RESOLUTION);
    let behind = View { outgoing: right.outgoing * Vec3::new(-1.0, 1.0, 1.0), ..right };
    TESTS.assert_refused("mirrored", chi_square_test(&right.counts_of(&behind, COUNT, 6), &right.expectations(COUNT, RESOLUTION)).p_value);
    let larger: Vec<f64> = expected.iter().map(|expected| 1.01 * expected).collect();
    TESTS.assert_refused("1 % larger", chi_square_test(&counts, &larger).p_value);
    // A sampler that draws again until it succeeds, with the density of one that does not.
    let stream = Stream::new(6, Purpose::Test);
    let failed = (0..COUNT.into()).filter(|&index| right.draw(&stream, index, Transport::Energy).is_none()).count() as u32;
    let mut again = right.counts(COUNT, 6);
    let more = right.counts(COUNT, 7);
    let share = f64::from(failed) / f64::from(COUNT - failed);
    again.iter_mut().zip(more).for_each(|(count, more)| *count += (more as f64 * share).round() as u64);
    *again.last_mut().unwrap() = 0;
    TESTS.assert_refused("drawn again", chi_square_test(&again, &right.expectations(COUNT, RESOLUTION)).p_value);
}

#[test]
fn wrong_weights_are_noticed() {
    let right = view("rough-conductor: { metal: ideal, alpha: 0.5 }", 75.0);
    TESTS.assert_plausible("right", albedo_p_value(&right, &right, 8));
    let separable = view("rough-conductor: { metal: ideal, alpha: 0.5, masking: separable }", 75.0);
    TESTS.assert_refused("separable masking", albedo_p_value(&separable, &right, 8));
    let glass = view("rough-dielectric: { alpha: 0.5 }", 135.0);
    let (radiance, error) = glass.mean_weight(COUNT, 8, Transport::Radiance);
    let energy = glass.directional_albedo(RESOLUTION, Transport::Energy).x;
    TESTS.assert_refused("radiance for energy", 2.0 * normal_cdf(-((radiance - energy) / error).abs()));
}
