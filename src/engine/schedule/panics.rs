//! Panics of stages: one line in the job's failure instead of a trace on the terminal.

use std::any::Any;
use std::collections::HashMap;
use std::panic;
use std::sync::Mutex;

/// Threads whose names begin so run stages: job threads, and those of the pool of `--jobs` threads.
pub const QUIET_THREADS: [&str; 2] = ["job", "pool"];

/// Places by message: a panic inside the pool is reported on another thread than the one that waits for it.
static PLACES: Mutex<Option<HashMap<String, String>>> = Mutex::new(None);

/// From now on a panic in a thread that runs stages is noted and not printed.
pub fn hush() {
    let before = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        let is_quiet = std::thread::current().name().is_some_and(|name| QUIET_THREADS.iter().any(|quiet| name.starts_with(quiet)));
        if !is_quiet {
            return before(info);
        }
        let place = info.location().map(|place| format!("{}:{}", short_path(place.file()), place.line())).unwrap_or_default();
        if let Ok(mut places) = PLACES.lock() {
            places.get_or_insert_default().insert(message_of(info.payload()), place);
        }
    }));
}

/// The end of a source file's path: what stands before it is a matter of the machine that built the program.
fn short_path(path: &str) -> &str {
    let starts = path.rmatch_indices('/').map(|(index, _)| index + 1);
    path.starts_with('/').then(|| starts.take(3).last()).flatten().map_or(path, |start| &path[start..])
}

fn message_of(payload: &dyn Any) -> String {
    let text = payload.downcast_ref::<String>().cloned();
    text.or_else(|| payload.downcast_ref::<&str>().map(|text| (*text).to_owned())).unwrap_or_default()
}

/// `file:line` of the last panic with that message.
pub fn place_of(message: &str) -> Option<String> {
    PLACES.lock().ok()?.as_ref()?.get(message).cloned()
}
