//! Renders a window of a picture over a block of samples.
//!
//! Every pixel is a function of the scene and its own position; rows are shared out among threads, so the result does
//! not depend on how many there are. A block that begins where a finished one ends goes on from its sums.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::render::film::sums::{Address, Block, Film, Fold, Refused, Sums, Window, channel};
use crate::render::integrator::path::{CAMERA_SETS, FirstHit, Transporter};
use crate::render::integrator::{Integrator, normals};
use crate::render::sampler::Numbers;
use crate::render::scene::compiled::Scene;

/// Set of the place on the film.
const FILM_SET: u32 = 0;
/// Set of the place on the lens.
const LENS_SET: u32 = 1;
const _: () = assert!(CAMERA_SETS == 2);

/// Samples of a pixel between two questions whether to stop.
const PATIENCE: u32 = 256;

/// What is to be rendered.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Which pixels.
    pub window: Window,
    /// Which samples of each replicate.
    pub block: Block,
    /// Replicates.
    pub replicates: u32,
    /// Sums of the first samples of the block, a power of two of them: where to go on from.
    pub start: Option<&'a Film>,
}

/// Renders; `progress` is told the finished part, from 0 to 1.
///
/// A `start` that does not fit the request is not used.
pub fn render<E: Send>(
    scene: &Scene,
    request: &Request<'_>,
    check: impl Fn() -> Result<(), E> + Sync,
    progress: impl Fn(f32) + Sync,
) -> Result<Film, E> {
    let Request { window, block, replicates, .. } = *request;
    let start = request.start.filter(|film| fits(film, request));
    let mut sums = vec![Sums::default(); window.pixel_count() * replicates as usize];
    let refused = Mutex::new(start.map_or(Refused::default(), |film| film.refused));
    let finished = AtomicUsize::new(0);
    let per_row = window.width() * replicates as usize;
    sums.par_chunks_mut(per_row.max(1)).enumerate().try_for_each(|(row, sums)| {
        let before = start.map(|film| &film.sums[row * per_row..][..per_row]);
        let line = Line { scene, request, y: window.y0 + row as u32, started: start.map_or(0, |film| film.block.count) };
        let found = line.render(sums, before, &check)?;
        if found != Refused::default() {
            let mut all = refused.lock().expect("no one panics while adding");
            *all = all.plus(found);
        }
        let done = finished.fetch_add(1, Ordering::Relaxed) + 1;
        progress(done as f32 / window.height() as f32);
        Ok(())
    })?;
    let refused = refused.into_inner().expect("no one panics while adding");
    Ok(Film { window, block, replicates, sums, refused })
}

/// Whether a film is the beginning of what is asked for, at a node of the tree of samples.
fn fits(film: &Film, request: &Request<'_>) -> bool {
    let count = film.block.count;
    film.window == request.window
        && film.replicates == request.replicates
        && film.block.first == request.block.first
        && film.sums.len() == request.window.pixel_count() * request.replicates as usize
        && count.is_power_of_two()
        && count <= request.block.count
}

/// One row of the window.
struct Line<'a> {
    scene: &'a Scene,
    request: &'a Request<'a>,
    y: u32,
    /// Samples that are done already.
    started: u32,
}

impl Line<'_> {
    fn render<E>(&self, sums: &mut [Sums], before: Option<&[Sums]>, check: &impl Fn() -> Result<(), E>) -> Result<Refused, E> {
        let Request { window, block, replicates, .. } = *self.request;
        let mut refused = Refused::default();
        let mut fold = Fold::default();
        for (place, sums) in sums.iter_mut().enumerate() {
            check()?;
            let (x, replicate) = (window.x0 + place as u32 / replicates, place as u32 % replicates);
            match before {
                Some(before) => fold.restart(before[place], self.started.trailing_zeros()),
                None => fold.clear(),
            }
            let numbers = self.scene.sampler.pixel(x, self.y, replicate);
            for index in block.first + self.started..block.first + block.count {
                if index % PATIENCE == PATIENCE - 1 {
                    check()?;
                }
                let sample = self.sample(x, &numbers.sample(index));
                let sample = sample.unwrap_or_else(|| {
                    let first = Some(Address { y: self.y, x, replicate, index });
                    refused = refused.plus(Refused { count: 1, first });
                    Sums::default()
                });
                fold.add(sample);
            }
            *sums = fold.total();
        }
        Ok(refused)
    }

    /// One sample; `None` where it is no finite color.
    #[inline]
    fn sample(&self, x: u32, numbers: &Numbers<'_>) -> Option<Sums> {
        let scene = self.scene;
        let [dx, dy] = scene.filter.offset(numbers.pair(FILM_SET));
        let lens = if scene.camera.has_lens() { numbers.pair(LENS_SET) } else { [0.5; 2] };
        let ray = scene.camera.ray([x as f32 + 0.5 + dx, self.y as f32 + 0.5 + dy], lens);
        let (color, first) = match &scene.integrator {
            Integrator::Path(transporter) => transporter.radiance(scene, ray, numbers),
            Integrator::Normals => {
                let first: FirstHit = Transporter::EMITTERS_ALONE.radiance(scene, ray, numbers).1;
                (normals::color(&first), first)
            }
        };
        let is_right = color.is_finite() && color.min_element() >= 0.0;
        is_right.then(|| {
            let mut sums = Sums::default();
            sums.set_triple(channel::COLOR, color.to_array());
            if scene.kept.squares {
                sums.set_triple(channel::SQUARE, (color * color).to_array());
            }
            if first.is_hit {
                self.keep_first(&first, &mut sums);
            }
            sums
        })
    }

    #[inline]
    fn keep_first(&self, first: &FirstHit, sums: &mut Sums) {
        let kept = &self.scene.kept;
        if kept.albedo {
            sums.set_triple(channel::ALBEDO, first.albedo.to_array());
        }
        if kept.normal {
            sums.set_triple(channel::NORMAL, first.normal.to_array());
        }
        if kept.depth {
            sums.0[channel::DEPTH] = first.depth;
        }
        if kept.coverage {
            sums.0[channel::COVERAGE] = 1.0;
        }
    }
}
