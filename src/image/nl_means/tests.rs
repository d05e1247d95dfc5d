use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::math::elementary;
use crate::math::stream::{Purpose, Stream};

fn settings() -> Settings {
    Settings { patch_radius: 3, window_radius: 10, k: 0.45, patchwise: false, border: Border::Clamp }
}

fn guide<'a>(color: &'a Raster, variance: &'a Raster) -> Guide<'a> {
    Guide { color, variance, coverage: None, features: &[] }
}

fn filtered(target: &Raster, guide: Guide<'_>, settings: Settings) -> Raster {
    filter(target, guide, settings, || Ok::<(), ()>(())).unwrap()
}

/// Noise of that variance around `mean`, uniform.
fn noisy(width: usize, height: usize, seed: u64, deviation: f64, mean: impl Fn(usize, usize) -> [f32; 3]) -> Raster {
    let stream = Stream::new(seed, Purpose::Test);
    let pixel = |index: usize| {
        let mut numbers = stream.generator(index as u64);
        mean(index % width, index / width).map(|value| value + ((numbers.uniform() - 0.5) * 12.0_f64.sqrt() * deviation) as f32)
    };
    Raster::new(width, height, (0..width * height).map(pixel).collect())
}

fn mean_square(a: &Raster, b: &Raster) -> f64 {
    let differences = a.pixels().as_flattened().iter().zip(b.pixels().as_flattened()).map(|(a, b)| f64::from(a - b));
    differences.map(|difference| difference * difference).sum::<f64>() / (3 * a.pixels().len()) as f64
}

/// The filter by its definition: one pixel, one candidate, one patch at a time, in f64.
fn by_definition(target: &Raster, guide: Guide<'_>, settings: Settings) -> Raster {
    let (width, height) = (target.width() as isize, target.height() as isize);
    let seen = |at: isize, length: isize| match settings.border {
        Border::Clamp => at.clamp(0, length - 1),
        Border::Wrap => at.rem_euclid(length),
    };
    let at = |raster: &Raster, x: isize, y: isize| raster.pixel(seen(x, width) as usize, seen(y, height) as usize).map(f64::from);
    let exists = |x: isize, y: isize| settings.border == Border::Wrap || ((0..width).contains(&x) && (0..height).contains(&y));
    let k_squared = f64::from(settings.k) * f64::from(settings.k);
    let pixel_distance = |[px, py]: [isize; 2], [qx, qy]: [isize; 2]| {
        let (up, uq) = (at(guide.color, px, py), at(guide.color, qx, qy));
        let (vp, vq) = (at(guide.variance, px, py), at(guide.variance, qx, qy));
        let of = |c: usize| ((up[c] - uq[c]) * (up[c] - uq[c]) - (vp[c] + vp[c].min(vq[c]))) / (1e-10 + k_squared * (vp[c] + vq[c]));
        (of(0) + of(1) + of(2)) / 3.0
    };
    let square = |radius: isize| (-radius..=radius).flat_map(move |y| (-radius..=radius).map(move |x| [x, y]));
    let weight = |[px, py]: [isize; 2], [qx, qy]: [isize; 2]| {
        let radius = settings.patch_radius as isize;
        let sum: f64 = square(radius).map(|[x, y]| pixel_distance([px + x, py + y], [qx + x, qy + y])).sum();
        elementary::exp(-(sum / square(radius).count() as f64).max(0.0))
    };
    let patchwise = settings.patchwise_radius() as isize;
    let pixel = |index: usize| {
        let p = [index as isize % width, index as isize / width];
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for [dx, dy] in square(settings.window_radius as isize) {
            let q = [p[0] + dx, p[1] + dy];
            if !exists(q[0], q[1]) {
                continue;
            }
            let around = square(patchwise).map(|[x, y]| weight([p[0] + x, p[1] + y], [q[0] + x, q[1] + y]));
            let w = around.sum::<f64>() / square(patchwise).count() as f64;
            let color = at(target, q[0], q[1]);
            (0..3).for_each(|c| sum[c] += w * color[c]);
            total += w;
        }
        sum.map(|sum| (sum / total) as f32)
    };
    Raster::new(target.width(), target.height(), (0..target.pixels().len()).map(pixel).collect())
}

#[test]
fn it_is_its_definition() {
    let color = noisy(8, 7, 1, 0.3, |x, y| [x as f32 * 0.1, if y > 4 { 2.0 } else { 0.5 }, 1.0]);
    let target = noisy(8, 7, 2, 0.3, |x, _| [1.0, x as f32, 3.0]);
    let variance = noisy(8, 7, 3, 0.02, |_, _| [0.09; 3]);
    for border in [Border::Clamp, Border::Wrap] {
        for patchwise in [false, true] {
            for (patch_radius, window_radius) in [(2, 3), (0, 2), (1, 0), (1, 8)] {
                let settings = Settings { patch_radius, window_radius, k: 0.7, patchwise, border };
                let expected = by_definition(&target, guide(&color, &variance), settings);
                let found = filtered(&target, guide(&color, &variance), settings);
                let worst = found.pixels().as_flattened().iter().zip(expected.pixels().as_flattened()).map(|(a, b)| (a - b).abs());
                let worst = worst.fold(0.0, f32::max);
                assert!(worst < 2e-5, "{settings:?}: {worst}");
            }
        }
    }
}

#[test]
fn an_image_without_noise_stays_as_it_is() {
    let image = noisy(70, 5, 4, 1.0, |_, _| [5.0; 3]);
    let none = Raster::filled(70, 5, [0.0; 3]);
    for patchwise in [false, true] {
        // Single pixels: patches that share most of their pixels' noise are not the same either.
        assert_eq!(filtered(&image, guide(&image, &none), Settings { patchwise, ..settings() }), image);
    }
}

#[test]
fn a_constant_stays_a_constant() {
    let image = Raster::filled(68, 20, [0.25, 1e6, 3e-5]);
    let variance = noisy(68, 20, 5, 0.1, |_, _| [1.0; 3]);
    let result = filtered(&image, guide(&image, &variance), settings());
    let worst = result.pixels().iter().zip(image.pixels()).flat_map(|(a, b)| (0..3).map(move |c| (a[c] / b[c] - 1.0).abs()));
    assert!(worst.fold(0.0, f32::max) < 1e-5);
}

#[test]
fn noise_on_flat_ground_falls_and_an_edge_stays() {
    let edge = |x: usize, _: usize| if x < 35 { [1.0; 3] } else { [4.0; 3] };
    let truth = noisy(70, 40, 1, 0.0, edge);
    let image = noisy(70, 40, 6, 0.2, edge);
    let variance = Raster::filled(70, 40, [0.04; 3]);
    let before = mean_square(&image, &truth);
    let after = mean_square(&filtered(&image, guide(&image, &variance), settings()), &truth);
    assert!(after < before / 20.0, "{before} {after}");
}

#[test]
fn features_keep_an_edge_that_drowns_in_noise() {
    let edge = |x: usize, _: usize| if x < 20 { [1.0; 3] } else { [1.3; 3] };
    let truth = noisy(40, 30, 1, 0.0, edge);
    let image = noisy(40, 30, 7, 0.5, edge);
    let variance = Raster::filled(40, 30, [0.25; 3]);
    let albedo = noisy(40, 30, 1, 0.0, |x, _| if x < 20 { [0.2; 3] } else { [0.8; 3] });
    let alone = mean_square(&filtered(&image, guide(&image, &variance), settings()), &truth);
    let features = [&albedo];
    let joint = mean_square(&filtered(&image, Guide { features: &features, ..guide(&image, &variance) }, settings()), &truth);
    assert!(joint < 0.5 * alone, "{alone} {joint}");
}

#[test]
fn a_feature_that_changes_evenly_holds_nothing_back() {
    let truth = noisy(40, 30, 1, 0.0, |_, _| [1.0; 3]);
    let image = noisy(40, 30, 7, 0.2, |_, _| [1.0; 3]);
    let variance = Raster::filled(40, 30, [0.04; 3]);
    let slope = noisy(40, 30, 1, 0.0, |x, y| [0.05 * x as f32, 0.03 * y as f32, 0.5]);
    let alone = mean_square(&filtered(&image, guide(&image, &variance), settings()), &truth);
    let joint = mean_square(&filtered(&image, Guide { features: &[&slope], ..guide(&image, &variance) }, settings()), &truth);
    assert!(joint < 1.3 * alone, "{alone} {joint}");
}

#[test]
fn uncovered_pixels_neither_change_nor_lend() {
    let image = noisy(30, 20, 8, 0.1, |x, _| if x < 15 { [1.0; 3] } else { [0.0; 3] });
    let coverage = Plane { width: 30, height: 20, values: (0..600).map(|i| if i % 30 < 15 { 1.0 } else { 0.0 }).collect() };
    // So uncertain that all weights are one: the mean over the covered pixels of the window.
    let variance = Raster::filled(30, 20, [100.0; 3]);
    let result = filtered(&image, Guide { coverage: Some(&coverage), ..guide(&image, &variance) }, settings());
    assert!((0..20).all(|y| (15..30).all(|x| result.pixel(x, y) == image.pixel(x, y))));
    assert!((0..20).all(|y| (result.pixel(14, y)[0] - 1.0).abs() < 0.05));
}

#[test]
fn an_error_of_the_check_ends_the_work() {
    let image = Raster::filled(3, 3, [1.0; 3]);
    assert_eq!(filter(&image, guide(&image, &image), settings(), || Err("stop")), Err("stop"));
    // Also in the middle of a tile, whose window may be large.
    let asked = AtomicUsize::new(0);
    let third = || if asked.fetch_add(1, Ordering::Relaxed) < 2 { Ok(()) } else { Err("stop") };
    assert_eq!(filter(&image, guide(&image, &image), settings(), third), Err("stop"));
}
