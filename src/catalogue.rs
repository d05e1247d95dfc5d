//! Tables of named things: look-up by name, and the nearest right word for a wrong one.
//!
//! Knows nothing of what it holds. Every family of the program (stage kinds, formats, BSDFs) is such a
//! table, so that adding a member is one file and one row.

/// Rows in the order in which they were added, each under a unique name.
#[derive(Debug, Clone)]
pub struct Catalogue<Row> {
    rows: Vec<(&'static str, Row)>,
}

impl<Row> Default for Catalogue<Row> {
    fn default() -> Self {
        Self { rows: Vec::new() }
    }
}

impl<Row> Catalogue<Row> {
    /// Adds a row.
    ///
    /// # Panics
    /// If the name is taken: two rows of one name are a fault of the program.
    pub fn add(&mut self, name: &'static str, row: Row) {
        assert!(self.find(name).is_none(), "`{name}` stands in the table already");
        self.rows.push((name, row));
    }

    /// The row of that exact name.
    pub fn find(&self, name: &str) -> Option<&Row> {
        self.rows.iter().find(|(candidate, _)| *candidate == name).map(|(_, row)| row)
    }

    /// All names, in order.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.rows.iter().map(|(name, _)| *name)
    }

    /// All rows with their names, in order.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, &Row)> + '_ {
        self.rows.iter().map(|(name, row)| (*name, row))
    }
}

/// The candidate nearest to `word`, if one is near enough to be what was meant.
///
/// Distance is the number of edits (insert, delete, replace, swap of neighbors) after folding case and
/// `_` to `-`; a third of the longer word's length, and at least one, may differ. A candidate that
/// begins with the word, or the other way round, counts as near (`exposure` for `exposure_stops`).
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let folded = fold(word);
    candidates
        .into_iter()
        .map(|candidate| (distance_between(&folded, &fold(candidate)), candidate))
        .min_by_key(|(distance, _)| *distance)
        .filter(|(distance, candidate)| {
            let longer = folded.len().max(candidate.chars().count());
            *distance <= (longer / 3).max(1)
        })
        .map(|(_, candidate)| candidate)
}

/// At most this many characters of a word are compared; names are far shorter.
const COMPARED_LENGTH: usize = 80;

fn fold(word: &str) -> Vec<char> {
    word.chars().take(COMPARED_LENGTH).flat_map(char::to_lowercase).map(|c| if c == '_' { '-' } else { c }).collect()
}

fn distance_between(word: &[char], candidate: &[char]) -> usize {
    let is_prefix = word.len() >= 3 && candidate.len() >= 3 && (candidate.starts_with(word) || word.starts_with(candidate));
    if is_prefix && word.len() != candidate.len() { 1 } else { edit_distance(word, candidate) }
}

/// Optimal string alignment distance (Damerau 1964, without repeated edits of one place).
fn edit_distance(a: &[char], b: &[char]) -> usize {
    let mut before: Vec<usize> = Vec::new();
    let mut above: Vec<usize> = (0..=b.len()).collect();
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let replaced = above[j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = replaced.min(above[j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(before[j - 2] + 1);
            }
            row.push(best);
        }
        before = std::mem::replace(&mut above, row);
    }
    above[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelt_word_finds_its_neighbor() {
        let words = ["sample", "tone-map", "exposure_stops", "median-cut"];
        assert_eq!(nearest("smaple", words), Some("sample"));
        assert_eq!(nearest("Tone_Map", words), Some("tone-map"));
        assert_eq!(nearest("exposure", words), Some("exposure_stops"));
        assert_eq!(nearest("zzz", words), None);
    }

    #[test]
    fn a_swap_of_neighbors_is_one_edit() {
        let letters = |word: &str| word.chars().collect::<Vec<_>>();
        assert_eq!(edit_distance(&letters("rsme"), &letters("rmse")), 1);
        assert_eq!(edit_distance(&letters(""), &letters("abc")), 3);
        assert_eq!(edit_distance(&letters("kitten"), &letters("sitting")), 3);
    }
}
