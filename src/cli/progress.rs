//! What a person sees while jobs run: bars on a terminal, else a line per finished job.
//!
//! The bars belong to one thread that looks at shared numbers ten times a second; nothing that computes
//! ever waits for a terminal.

use std::io::Write;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressFinish, ProgressStyle};

use super::arguments::TalkArguments;
use super::outcomes::{Outcomes, cut};
use super::screen::Screen;
use crate::engine::diagnostic::escape;
use crate::engine::events::Event;
use crate::engine::manifest::Outcome;

/// Time between two looks at the numbers.
const REFRESH: Duration = Duration::from_millis(100);

/// Shows how a run goes on.
pub struct Progress {
    screen: Screen,
    talk: TalkArguments,
    threads: NonZeroUsize,
    board: Arc<Mutex<Board>>,
    is_over: Arc<AtomicBool>,
    painter: Option<JoinHandle<()>>,
    /// What is told on a terminal when the bars are gone.
    outcomes: Outcomes,
}

/// The numbers that the bars show.
#[derive(Default)]
struct Board {
    done: usize,
    total: usize,
    /// Those of the done that took time.
    ran: usize,
    /// Those of the done whose result was in the store.
    reused: usize,
    running: Vec<RunningJob>,
}

struct RunningJob {
    name: String,
    /// Why it runs.
    reason: String,
    permille: Arc<AtomicU32>,
    since: Instant,
}

impl Progress {
    /// Shows nothing yet; on a terminal bars come with the first job that runs.
    pub fn new(screen: &Screen, talk: TalkArguments, threads: NonZeroUsize) -> Self {
        Self {
            screen: *screen,
            talk,
            threads,
            board: Arc::default(),
            is_over: Arc::default(),
            painter: None,
            outcomes: Outcomes::default(),
        }
    }

    /// Takes an event in.
    pub fn notify(&mut self, event: &Event) {
        if self.talk.quiet {
            return;
        }
        match event {
            Event::Planned { jobs, hits } => {
                let mut board = self.board.lock().expect(NO_PANIC);
                (board.total, board.done) = (*jobs, 0);
                drop(board);
                if self.talk.verbose {
                    self.screen.say(&format!("{jobs} jobs, {hits} of them in the store\n"));
                }
            }
            Event::Restoring { files, progress } => {
                let mut board = self.board.lock().expect(NO_PANIC);
                board.done = board.total;
                drop(board);
                self.show(format!("{files} files of an earlier run are put back"), String::new(), progress);
            }
            Event::Started { job, reason, progress } => self.show(job.clone(), reason.clone(), progress),
            Event::Finished { job, outcome, reason, seconds, done, total, is_part, .. } => {
                let mut board = self.board.lock().expect(NO_PANIC);
                board.done = *done;
                board.ran += usize::from(*outcome == Outcome::Ran);
                board.reused += usize::from(*outcome == Outcome::Hit);
                board.running.retain(|running| running.name != *job);
                drop(board);
                if self.screen.is_terminal && !is_part {
                    self.outcomes.add(job.split('[').next().unwrap_or(job), *outcome, reason);
                }
                self.line(job, *outcome, reason, *seconds, (*done, *total));
            }
            Event::Elsewhere { job, owner } => {
                self.board.lock().expect(NO_PANIC).running.retain(|running| running.name != *job);
                if self.talk.verbose && self.painter.is_none() {
                    self.screen.say(&format!("waits for {}, which {} computes\n", escape(job), escape(owner)));
                }
            }
            Event::Waiting { workers, reason } if self.painter.is_none() => {
                let wait = if *workers == 1 { "worker waits" } else { "workers wait" };
                self.screen.say(&format!("{workers} {wait} to be started: {}\n", escape(reason)));
            }
            Event::Waiting { .. } | Event::Published { .. } | Event::Warning { .. } | Event::Ended { .. } => {}
        }
    }

    /// Gives a row to what goes on.
    fn show(&mut self, name: String, reason: String, permille: &Arc<AtomicU32>) {
        let running = RunningJob { name, reason, permille: permille.clone(), since: Instant::now() };
        self.board.lock().expect(NO_PANIC).running.push(running);
        if self.screen.is_terminal && self.painter.is_none() {
            self.start_painter();
        }
    }

    /// A line for a job that did something; for all jobs if more is to be said.
    fn line(&self, job: &str, outcome: Outcome, reason: &str, seconds: f64, (done, total): (usize, usize)) {
        let is_bar = self.painter.is_some();
        let is_shown = self.talk.verbose || (outcome != Outcome::Hit && !self.screen.is_terminal);
        if is_bar || !is_shown {
            return;
        }
        let time = if outcome == Outcome::Ran { format!("  {seconds:.2} s") } else { String::new() };
        let why = if reason.is_empty() { String::new() } else { format!("  {}", escape(reason)) };
        self.screen.say(&format!("[{done}/{total}] {:4} {}{time}{why}\n", outcome.word(), escape(job)));
    }

    fn start_painter(&mut self) {
        let (board, is_over, rows) = (self.board.clone(), self.is_over.clone(), self.threads.get().min(MOST_ROWS));
        let thread = std::thread::Builder::new().name("progress".into()).spawn(move || paint(&board, &is_over, rows));
        self.painter = thread.ok();
    }

    /// Takes the bars away, and tells instead what ran and why.
    pub fn end(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(painter) = self.painter.take() {
            painter.thread().unpark();
            let _ = painter.join();
            self.screen.say(&self.outcomes.text());
        }
    }
}

const NO_PANIC: &str = "no one panics while holding the board";

/// More rows than this are no help.
const MOST_ROWS: usize = 8;

/// After so many jobs the time that is left is guessed.
const GUESS_COUNT: usize = 5;

fn paint(board: &Mutex<Board>, is_over: &AtomicBool, rows: usize) {
    let bars = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(20));
    let overall_style = ProgressStyle::with_template("[{pos}/{len}] {wide_bar} {msg}").expect("the template is right");
    let row_style = ProgressStyle::with_template("  {msg}").expect("the template is right");
    // A bar that is dropped draws itself once more unless it is told to clear.
    let overall = bars.add(ProgressBar::new(0).with_style(overall_style).with_finish(ProgressFinish::AndClear));
    let row = || ProgressBar::new_spinner().with_style(row_style.clone()).with_finish(ProgressFinish::AndClear);
    let lines: Vec<ProgressBar> = (0..rows).map(|_| bars.add(row())).collect();
    let start = Instant::now();
    while !is_over.load(Ordering::Relaxed) {
        let (done, total, time, texts) = {
            let board = board.lock().expect(NO_PANIC);
            (board.done, board.total, time_text(&board, start.elapsed()), board.running.iter().map(row_text).collect::<Vec<_>>())
        };
        overall.set_message(time);
        overall.set_length(total as u64);
        overall.set_position(done as u64);
        overall.tick();
        for (index, line) in lines.iter().enumerate() {
            line.set_message(texts.get(index).cloned().unwrap_or_default());
            line.tick();
        }
        // The cursor is left at the edge of the last row, where the `^C` that a terminal writes would begin another line; then one
        // line of the bars would stay. At the start of the row it does no harm.
        let _ = std::io::stderr().write_all(b"\r");
        std::thread::park_timeout(REFRESH);
    }
    let _ = bars.clear();
}

/// How many results were there already, how long it has taken and, once that can be guessed, how long it will still take.
fn time_text(board: &Board, elapsed: Duration) -> String {
    let seconds = elapsed.as_secs_f64();
    let reused = if board.reused > 0 { format!("{} reused, ", board.reused) } else { String::new() };
    // Jobs differ in cost: of a few of them nothing can be said.
    if board.ran < GUESS_COUNT || board.done >= board.total {
        return format!("{reused}{}", seconds_text(seconds));
    }
    let left = seconds * (board.total - board.done) as f64 / board.ran as f64;
    format!("{reused}{}, about {} left", seconds_text(seconds), seconds_text(left))
}

fn seconds_text(seconds: f64) -> String {
    match seconds as u64 {
        seconds @ 0..120 => format!("{seconds} s"),
        seconds @ 120..7200 => format!("{} min", seconds / 60),
        seconds => format!("{} h", seconds / 3600),
    }
}

/// Longest name of a job in a row, so that the row ends before the edge of a terminal of 80 columns.
const NAME_LENGTH: usize = 60;

/// Width of a row beside its indent, on a terminal of 80 columns.
const ROW_WIDTH: usize = 76;

/// Shorter than this a reason says nothing.
const LEAST_REASON: usize = 12;

/// What runs, how far it is and for how long, and why as far as there is room.
fn row_text(job: &RunningJob) -> String {
    let permille = job.permille.load(Ordering::Relaxed);
    let percent = if permille > 0 { format!("  {} %", permille / 10) } else { String::new() };
    let row = format!("{}{percent}  {}", shortened(&escape(&job.name)), seconds_text(job.since.elapsed().as_secs_f64()));
    let room = ROW_WIDTH.saturating_sub(row.chars().count() + 2);
    let reason = escape(&job.reason);
    if reason.is_empty() || room < LEAST_REASON { row } else { format!("{row}  {}", cut(&reason, room)) }
}

/// Beginning and end of a name that is too long: the coordinate at its end tells jobs of a stage apart.
fn shortened(name: &str) -> String {
    let letters: Vec<char> = name.chars().collect();
    if letters.len() <= NAME_LENGTH {
        return name.to_owned();
    }
    let (start, end) = (NAME_LENGTH / 3, letters.len() - (NAME_LENGTH - NAME_LENGTH / 3 - 1));
    letters[..start].iter().chain(&['…']).chain(&letters[end..]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_ends_before_the_edge_of_a_terminal() {
        let name = format!("stage[{}]", "axis=value,".repeat(20));
        let since = Instant::now().checked_sub(Duration::from_secs(5999)).unwrap_or_else(Instant::now);
        let reason = "parameter size 41 -> 43; ".repeat(9);
        let mut job = RunningJob { name, reason, permille: Arc::new(AtomicU32::new(999)), since };
        let row = row_text(&job);
        assert!(row.chars().count() <= 74 && row.starts_with("stage[") && row.contains(",]  99 %"), "{row}");
        job.name = "sphere[n=4]".into();
        let row = row_text(&job);
        assert!(row.chars().count() <= ROW_WIDTH && row.contains("99 min  parameter size 41 -> 43"), "{row}");
        assert_eq!(shortened("short"), "short");
    }

    #[test]
    fn the_time_left_is_guessed_from_several_jobs() {
        let board = |ran, done, total| Board { done, total, ran, reused: done - ran, running: Vec::new() };
        let text = |board: Board| time_text(&board, Duration::from_secs(10));
        assert_eq!(text(board(1, 1, 100)), "10 s");
        assert_eq!(text(board(5, 55, 60)), "50 reused, 10 s, about 10 s left");
        assert_eq!(text(board(10, 10, 10)), "10 s");
        assert_eq!((seconds_text(119.9), seconds_text(600.0), seconds_text(8000.0)), ("119 s".into(), "10 min".into(), "2 h".into()));
    }
}
