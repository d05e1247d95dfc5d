//! Axis values and coordinates, and their one text form.

use std::fmt;

use serde::{Deserialize, Serialize, Serializer};

/// A value of an axis, a cell's origin, a plain parameter.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum Scalar {
    /// `true` or `false`.
    Boolean(bool),
    /// Any integer that fits u64 or i64; whole floats below 2^53 are integers too (1.0 and 1 are one value).
    Integer(i128),
    /// A finite number with a fraction or beyond 2^53.
    Number(f64),
    /// Text.
    Text(String),
}

/// Whole floats up to here are stored as integers: beyond, neighbors are not distinct integers.
const WHOLE_LIMIT: f64 = 9_007_199_254_740_992.0;

impl Scalar {
    /// A number in its one form: an integer where it is whole.
    pub fn from_number(value: f64) -> Self {
        if value.fract() == 0.0 && value.abs() <= WHOLE_LIMIT { Scalar::Integer(value as i128) } else { Scalar::Number(value) }
    }

    /// The value as a number, if it is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Scalar::Integer(value) => Some(*value as f64),
            Scalar::Number(value) => Some(*value),
            Scalar::Boolean(_) | Scalar::Text(_) => None,
        }
    }
}

impl fmt::Display for Scalar {
    /// Shortest form that reads back as the same value; integers without a point.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Scalar::Boolean(value) => value.fmt(out),
            Scalar::Integer(value) => value.fmt(out),
            // `{:?}` is the shortest round-trip form and switches to an exponent for large and small values.
            Scalar::Number(value) => write!(out, "{value:?}"),
            Scalar::Text(value) => value.fmt(out),
        }
    }
}

impl Serialize for Scalar {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Scalar::Boolean(value) => serializer.serialize_bool(*value),
            Scalar::Integer(value) => match (u64::try_from(*value), i64::try_from(*value)) {
                (Ok(value), _) => serializer.serialize_u64(value),
                (_, Ok(value)) => serializer.serialize_i64(value),
                _ => serializer.serialize_f64(*value as f64),
            },
            Scalar::Number(value) => serializer.serialize_f64(*value),
            Scalar::Text(value) => serializer.serialize_str(value),
        }
    }
}

/// Where a job stands: one value per axis that its stage has, in the order in which the axes are declared.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Coordinate(pub Vec<(String, Scalar)>);

impl Coordinate {
    /// The value on that axis.
    pub fn value(&self, axis: &str) -> Option<&Scalar> {
        self.0.iter().find(|(name, _)| name == axis).map(|(_, value)| value)
    }

    /// Whether there is no axis at all.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl fmt::Display for Coordinate {
    /// `n=64,gamma=2.2`; empty where there is no axis.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, (axis, value)) in self.0.iter().enumerate() {
            let comma = if index == 0 { "" } else { "," };
            write!(out, "{comma}{axis}={value}")?;
        }
        Ok(())
    }
}

impl Serialize for Coordinate {
    /// A map from axis to value, in order.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(axis, value)| (axis, value)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_have_one_text() {
        assert_eq!(Scalar::from_number(1.0), Scalar::Integer(1));
        assert_eq!(Scalar::from_number(2.2).to_string(), "2.2");
        assert_eq!(Scalar::from_number(1e-7).to_string(), "1e-7");
        assert_eq!(Scalar::Integer(u64::MAX as i128).to_string(), "18446744073709551615");
    }

    #[test]
    fn a_coordinate_reads_as_axes_in_order() {
        let coordinate = Coordinate(vec![("n".into(), Scalar::Integer(64)), ("gamma".into(), Scalar::Number(2.2))]);
        assert_eq!(coordinate.to_string(), "n=64,gamma=2.2");
        assert_eq!(serde_json::to_string(&coordinate).unwrap(), r#"{"n":64,"gamma":2.2}"#);
    }
}
