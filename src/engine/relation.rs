//! Sets of coordinates: what exists of a stage, and how such sets are joined by the names of axes.
//!
//! A product of axes is kept as a product, so that its size is known before anything is expanded; only
//! `exclude` over several axes makes a list of it. Values are indices into their axis.

use std::collections::{BTreeSet, HashMap};

/// One coordinate: an index of a value per axis.
pub type Row = Box<[u32]>;

/// A set of coordinates over some axes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Relation {
    /// Indices of the axes, ascending: the order of declaration.
    pub axes: Vec<usize>,
    rows: Rows,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Rows {
    /// All combinations of these values, each list ascending.
    Product(Vec<Vec<u32>>),
    /// These rows, ascending.
    Listed(Vec<Row>),
}

/// More coordinates than may be listed; the exact number where it is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooMany(pub Option<u128>);

impl Relation {
    /// One coordinate without axes.
    pub fn unit() -> Self {
        Self { axes: Vec::new(), rows: Rows::Product(Vec::new()) }
    }

    /// All values of one axis.
    pub fn of_axis(axis: usize, count: usize) -> Self {
        Self { axes: vec![axis], rows: Rows::Product(vec![(0..count as u32).collect()]) }
    }

    /// How many coordinates; `None` beyond 128 bits.
    pub fn count(&self) -> Option<u128> {
        match &self.rows {
            Rows::Product(values) if values.iter().any(Vec::is_empty) => Some(0),
            Rows::Product(values) => values.iter().try_fold(1_u128, |product, values| product.checked_mul(values.len() as u128)),
            Rows::Listed(rows) => Some(rows.len() as u128),
        }
    }

    /// All coordinates, ascending.
    pub fn rows(&self) -> Vec<Row> {
        match &self.rows {
            Rows::Product(values) => combinations(values),
            Rows::Listed(rows) => rows.clone(),
        }
    }

    /// The coordinates that have one of these values on an axis.
    #[must_use]
    pub fn restricted(&self, axis: usize, kept: &[u32]) -> Self {
        let position = self.position(axis);
        let rows = match &self.rows {
            Rows::Product(values) => {
                let mut values = values.clone();
                values[position].retain(|value| kept.contains(value));
                Rows::Product(values)
            }
            Rows::Listed(rows) => Rows::Listed(rows.iter().filter(|row| kept.contains(&row[position])).cloned().collect()),
        };
        Self { axes: self.axes.clone(), rows }
    }

    /// The coordinates without some axes, each once.
    #[must_use]
    pub fn without(&self, dropped: &[usize]) -> Self {
        let kept: Vec<usize> = (0..self.axes.len()).filter(|position| !dropped.contains(&self.axes[*position])).collect();
        let axes = kept.iter().map(|position| self.axes[*position]).collect();
        let rows = match &self.rows {
            Rows::Product(values) if values.iter().any(Vec::is_empty) => Rows::Listed(Vec::new()),
            Rows::Product(values) => Rows::Product(kept.iter().map(|position| values[*position].clone()).collect()),
            Rows::Listed(rows) => {
                let distinct: BTreeSet<Row> = rows.iter().map(|row| kept.iter().map(|position| row[*position]).collect()).collect();
                Rows::Listed(distinct.into_iter().collect())
            }
        };
        Self { axes, rows }
    }

    /// The coordinates over the axes of both that agree with both.
    pub fn joined(&self, other: &Self, limit: u64) -> Result<Self, TooMany> {
        let axes: BTreeSet<usize> = self.axes.iter().chain(&other.axes).copied().collect();
        let axes: Vec<usize> = axes.into_iter().collect();
        let rows = match (&self.rows, &other.rows) {
            (Rows::Product(mine), Rows::Product(theirs)) => {
                let values = axes.iter().map(|axis| match (self.find(*axis), other.find(*axis)) {
                    (Some(a), Some(b)) => mine[a].iter().filter(|value| theirs[b].binary_search(value).is_ok()).copied().collect(),
                    (Some(a), None) => mine[a].clone(),
                    (None, b) => theirs[b.expect("every axis is of one of the two")].clone(),
                });
                Rows::Product(values.collect())
            }
            (Rows::Listed(_), _) => Rows::Listed(self.listed_join(other, &axes, limit)?),
            (_, Rows::Listed(_)) => Rows::Listed(other.listed_join(self, &axes, limit)?),
        };
        Ok(Self { axes, rows })
    }

    /// The join of a list with anything, row by row.
    fn listed_join(&self, other: &Self, axes: &[usize], limit: u64) -> Result<Vec<Row>, TooMany> {
        let shared: Vec<usize> = self.axes.iter().filter(|axis| other.find(**axis).is_some()).copied().collect();
        if other.count().is_none_or(|count| count > u128::from(limit)) {
            return Err(TooMany(None));
        }
        let mut partners: HashMap<Row, Vec<Row>> = HashMap::new();
        for row in other.rows() {
            partners.entry(other.key(&row, &shared)).or_default().push(row);
        }
        let mut joined = Vec::new();
        for row in self.rows() {
            let matching = partners.get(&self.key(&row, &shared)).map(Vec::as_slice).unwrap_or_default();
            if joined.len() as u64 + matching.len() as u64 > limit {
                return Err(TooMany(None));
            }
            joined.extend(matching.iter().map(|partner| self.combined(&row, other, partner, axes)));
        }
        joined.sort();
        Ok(joined)
    }

    fn combined(&self, row: &[u32], other: &Self, partner: &[u32], axes: &[usize]) -> Row {
        let value = |axis: &usize| match self.find(*axis) {
            Some(position) => row[position],
            None => partner[other.position(*axis)],
        };
        axes.iter().map(value).collect()
    }

    /// The values of a row on some axes of this relation.
    pub fn key(&self, row: &[u32], axes: &[usize]) -> Row {
        axes.iter().map(|axis| row[self.position(*axis)]).collect()
    }

    /// Without the coordinates that agree with one of the exclusions: lists of (axis, values).
    pub fn excluding(&self, exclusions: &[Vec<(usize, Vec<u32>)>], limit: u64) -> Result<Self, TooMany> {
        let (simple, compound): (Vec<_>, Vec<_>) = exclusions.iter().partition(|exclusion| exclusion.len() == 1);
        let mut left = self.clone();
        for (axis, values) in simple.into_iter().flatten() {
            left = left.without_values(*axis, values);
        }
        if compound.is_empty() {
            return Ok(left);
        }
        if left.count().is_none_or(|count| count > u128::from(limit)) {
            return Err(TooMany(left.count()));
        }
        let is_excluded =
            |row: &Row| compound.iter().any(|exclusion| exclusion.iter().all(|(axis, values)| values.contains(&row[left.position(*axis)])));
        let rows = left.rows().into_iter().filter(|row| !is_excluded(row)).collect();
        Ok(Self { axes: left.axes.clone(), rows: Rows::Listed(rows) })
    }

    fn without_values(&self, axis: usize, dropped: &[u32]) -> Self {
        let position = self.position(axis);
        let rows = match &self.rows {
            Rows::Product(values) => {
                let mut values = values.clone();
                values[position].retain(|value| !dropped.contains(value));
                Rows::Product(values)
            }
            Rows::Listed(rows) => Rows::Listed(rows.iter().filter(|row| !dropped.contains(&row[position])).cloned().collect()),
        };
        Self { axes: self.axes.clone(), rows }
    }

    fn find(&self, axis: usize) -> Option<usize> {
        self.axes.iter().position(|own| *own == axis)
    }

    fn position(&self, axis: usize) -> usize {
        self.find(axis).expect("only axes of the relation are asked for")
    }
}

/// All combinations, the last position running fastest.
fn combinations(values: &[Vec<u32>]) -> Vec<Row> {
    let mut rows: Vec<Vec<u32>> = vec![Vec::with_capacity(values.len())];
    for values in values {
        let extended = rows.iter().flat_map(|row| values.iter().map(|value| row.iter().copied().chain([*value]).collect()));
        rows = extended.collect();
    }
    rows.into_iter().map(Vec::into_boxed_slice).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: u64 = 1000;

    fn axis(axis: usize, count: usize) -> Relation {
        Relation::of_axis(axis, count)
    }

    #[test]
    fn shared_axes_are_joined_and_others_broadcast() {
        let a = axis(0, 3).joined(&axis(1, 2), LIMIT).unwrap();
        let b = axis(1, 2).joined(&axis(2, 4), LIMIT).unwrap();
        let joined = a.joined(&b, LIMIT).unwrap();
        assert_eq!((joined.axes.clone(), joined.count()), (vec![0, 1, 2], Some(24)));
        assert_eq!(joined.rows().len(), 24);
    }

    #[test]
    fn a_listed_join_agrees_with_a_product() {
        let a = axis(0, 3).joined(&axis(1, 2), LIMIT).unwrap();
        let b = axis(1, 2).joined(&axis(2, 4), LIMIT).unwrap();
        let listed = a.excluding(&[vec![(0, vec![2]), (1, vec![1])]], LIMIT).unwrap();
        assert_eq!(listed.count(), Some(5));
        let expected: Vec<Row> = a.joined(&b, LIMIT).unwrap().rows().into_iter().filter(|row| !(row[0] == 2 && row[1] == 1)).collect();
        assert_eq!(listed.joined(&b, LIMIT).unwrap().rows(), expected);
        assert_eq!(b.joined(&listed, LIMIT).unwrap().rows(), expected);
    }

    #[test]
    fn one_axis_is_excluded_without_listing() {
        let huge = (0..40).map(|index| axis(index, 2)).reduce(|a, b| a.joined(&b, LIMIT).unwrap()).unwrap();
        assert_eq!(huge.count(), Some(1 << 40));
        let half = huge.excluding(&[vec![(3, vec![0])]], LIMIT).unwrap();
        assert_eq!(half.count(), Some(1 << 39));
        assert_eq!(huge.excluding(&[vec![(3, vec![0]), (4, vec![0])]], LIMIT), Err(TooMany(Some(1 << 40))));
        let beyond = (0..140).map(|index| axis(index, 2)).reduce(|a, b| a.joined(&b, LIMIT).unwrap()).unwrap();
        assert_eq!(beyond.count(), None);
    }

    #[test]
    fn what_has_no_coordinate_gives_none_when_collapsed() {
        let none = axis(0, 2).excluding(&[vec![(0, vec![0, 1])]], LIMIT).unwrap();
        assert_eq!(none.without(&[0]).count(), Some(0));
        assert_eq!(axis(0, 2).without(&[0]).count(), Some(1));
    }
}
