//! Times of scattering, one draw or one evaluation each: `cargo bench --bench bsdf`. One thread.

use divan::{Bencher, black_box};
use glam::Vec3;
use pipeline::math::stream::{Purpose, Stream};
use pipeline::render::bsdf::material::Material;
use pipeline::render::bsdf::measure::EXAMPLES;
use pipeline::render::bsdf::{Bsdf, BsdfDescription, DirectionSampling, Transport};
use pipeline::render::texture::TexturePoint;

fn main() {
    divan::main();
}

fn bsdf(text: &str) -> Bsdf<'static> {
    let json: serde_json::Value = serde_yaml::from_str(text).expect("an example");
    let description: BsdfDescription = serde_json::from_value(json).expect("an example");
    let material = Material::new(&description, DirectionSampling::Bsdf).expect("an example");
    Box::leak(Box::new(material)).at(&TexturePoint::ANYWHERE)
}

/// Directions above the surface and numbers, so that no branch is foretold.
fn numbers() -> Vec<(Vec3, f32, [f32; 2])> {
    let stream = Stream::new(1, Purpose::Test);
    let item = |index| {
        let mut numbers = stream.generator(index);
        let mut uniform = || numbers.uniform() as f32 * 0.999_999;
        let (z, azimuth) = (0.05 + 0.95 * uniform(), uniform());
        let (sine, cosine) = pipeline::math::single::sin_cos_of_turns(azimuth);
        let radius = (1.0 - z * z).sqrt();
        (Vec3::new(radius * cosine, radius * sine, z), uniform(), [uniform(), uniform()])
    };
    (0..4096).map(item).collect()
}

/// Draws 4096 directions.
#[divan::bench(args = EXAMPLES)]
fn draw(bencher: Bencher<'_, '_>, text: &str) {
    let (bsdf, numbers) = (bsdf(text), numbers());
    bencher.counter(numbers.len()).bench(|| {
        let weight = |(outgoing, choice, point): &(Vec3, f32, [f32; 2])| {
            bsdf.sample(black_box(*outgoing), *choice, *point, Transport::Radiance).map_or(0.0, |sample| sample.weight.x + sample.pdf)
        };
        numbers.iter().map(weight).sum::<f32>()
    });
}

/// Values and densities of 4096 pairs of directions.
#[divan::bench(args = EXAMPLES)]
fn evaluate(bencher: Bencher<'_, '_>, text: &str) {
    let (bsdf, numbers) = (bsdf(text), numbers());
    bencher.counter(numbers.len()).bench(|| {
        let value = |pair: &[(Vec3, f32, [f32; 2])]| {
            let (value, pdf) = bsdf.evaluate_with_pdf(black_box(pair[0].0), pair[1].0, Transport::Radiance);
            value.x + pdf
        };
        numbers.windows(2).map(value).sum::<f32>()
    });
}
