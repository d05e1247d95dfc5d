//! Ranges, positions and labels of axes: which numbers stand where, and how they are written.
//!
//! Labelled values are round (1, 2, 5 times a power of ten; 15, 30, 45 for degrees), powers of ten on
//! logarithmic axes, or the data's own values where there are few (counts in powers of two).

use super::chart::{Axis, Scale};
use crate::math::elementary;

/// The numbers that an axis shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// How they are spaced.
    pub scale: Scale,
    /// The first.
    pub low: f64,
    /// The last; greater than the first.
    pub high: f64,
}

impl Span {
    /// Position along the axis: 0 at its first number, 1 at its last, beyond outside; `None` if it has none (a logarithm of 0).
    pub fn fraction(&self, value: f64) -> Option<f64> {
        let [low, high, value] = match self.scale {
            Scale::Linear => [self.low, self.high, value],
            Scale::Logarithmic if value > 0.0 => [self.low, self.high, value].map(elementary::ln),
            Scale::Logarithmic => return None,
        };
        Some((value - low) / (high - low))
    }

    /// Like [`Span::fraction`], with numbers at or below 0 far below a logarithmic axis.
    pub fn fraction_or_below(&self, value: f64) -> f64 {
        self.fraction(value).unwrap_or(-10.0)
    }

    fn contains(&self, value: f64) -> bool {
        // Labelled values are products that may miss the end by a rounding.
        self.fraction(value).is_some_and(|fraction| (-1e-9..=1.0 + 1e-9).contains(&fraction))
    }
}

/// How far an axis reaches beyond its data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Part of its length added at each end that is not a bound by itself.
    pub margin: f64,
    /// Whether zero belongs to it if the data come near.
    pub is_from_zero: bool,
}

/// The span of an axis over these data.
pub fn span(axis: &Axis, data: impl Iterator<Item = f64>, reach: Reach) -> Span {
    let scale = axis.scale;
    if let Some([low, high]) = axis.range.filter(|[low, high]| low < high && (scale == Scale::Linear || *low > 0.0)) {
        return Span { scale, low, high };
    }
    if !axis.categories.is_empty() {
        return Span { scale: Scale::Linear, low: -0.5, high: axis.categories.len() as f64 - 0.5 };
    }
    let shown = data.filter(|value| scale == Scale::Linear || *value > 0.0);
    let [low, high] = shown.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
    match scale {
        Scale::Linear => linear_span(low, high, reach),
        Scale::Logarithmic => logarithmic_span(low, high, reach.margin),
    }
}

fn linear_span(low: f64, high: f64, reach: Reach) -> Span {
    let scale = Scale::Linear;
    if low > high {
        return Span { scale, low: 0.0, high: 1.0 };
    }
    let starts_at_zero = reach.is_from_zero && low >= 0.0 && low <= 0.5 * high && high > 0.0;
    let ends_at_zero = reach.is_from_zero && high <= 0.0 && high >= 0.5 * low && low < 0.0;
    let (low, high) = (if starts_at_zero { 0.0 } else { low }, if ends_at_zero { 0.0 } else { high });
    if low == high {
        let half = if low == 0.0 { 0.5 } else { 0.1 * low.abs() };
        return Span { scale, low: low - half, high: high + half };
    }
    let margin = reach.margin * (high - low);
    Span { scale, low: if starts_at_zero { 0.0 } else { low - margin }, high: if ends_at_zero { 0.0 } else { high + margin } }
}

fn logarithmic_span(low: f64, high: f64, margin: f64) -> Span {
    let scale = Scale::Logarithmic;
    if low > high {
        return Span { scale, low: 0.1, high: 1.0 };
    }
    let factor = if low == high { 2.0 } else { elementary::exp(margin * elementary::ln(high / low)) };
    Span { scale, low: (low / factor).max(f64::MIN_POSITIVE), high: (high * factor).min(f64::MAX) }
}

/// A labelled value.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// Where.
    pub value: f64,
    /// How it is written.
    pub label: String,
}

/// The values that an axis marks.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ticks {
    /// Those with a label.
    pub major: Vec<Tick>,
    /// Those without.
    pub minor: Vec<f64>,
    /// Labels are to be multiplied by ten to this power.
    pub exponent: i32,
}

/// Values for an axis on which about `count` labels have room.
///
/// `own` are the data's values: where they are few on a logarithmic axis, they are the labels.
pub fn ticks(axis: &Axis, span: Span, count: f64, own: &[f64]) -> Ticks {
    if !axis.categories.is_empty() {
        let major = axis.categories.iter().enumerate().map(|(index, label)| Tick { value: index as f64, label: label.clone() });
        return Ticks { major: major.collect(), ..Ticks::default() };
    }
    match span.scale {
        Scale::Linear => linear_ticks(span, count, is_in_degrees(axis)),
        Scale::Logarithmic => own_ticks(span, own).unwrap_or_else(|| logarithmic_ticks(span, count)),
    }
}

fn is_in_degrees(axis: &Axis) -> bool {
    axis.unit == "deg" || axis.unit == "°"
}

/// Ten to that power, correctly rounded.
fn power_of_ten(exponent: i32) -> f64 {
    format!("1e{exponent}").parse().expect("an exponent of a finite number")
}

fn linear_ticks(span: Span, count: f64, is_in_degrees: bool) -> Ticks {
    let wanted = (span.high - span.low) / count.max(1.0);
    let exponent = elementary::log10(wanted).floor() as i32;
    let (digit, exponent) = match [1.0, 2.0, 5.0].into_iter().find(|digit| digit * power_of_ten(exponent) >= wanted * 0.999) {
        Some(digit) => (digit, exponent),
        None => (1.0, exponent + 1),
    };
    let round = digit * power_of_ten(exponent);
    let angles = [15.0, 30.0, 45.0, 90.0].into_iter().find(|step| *step >= wanted * 0.999).filter(|_| is_in_degrees && wanted > 5.0);
    let step = angles.unwrap_or(round);
    let values: Vec<f64> = ((span.low / step).ceil() as i64 - 1..=(span.high / step).floor() as i64 + 1)
        .map(|index| index as f64 * step)
        .filter(|value| span.contains(*value))
        .collect();

    let largest = values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let shift = if largest >= 1e6 || (largest > 0.0 && largest < 2e-3) { elementary::log10(largest).floor() as i32 } else { 0 };
    let decimals = if angles.is_some() { 0 } else { (shift - exponent).max(0) as usize };
    let major = values.into_iter().map(|value| Tick { value, label: fixed(value / power_of_ten(shift), decimals) }).collect();
    Ticks { major, minor: Vec::new(), exponent: shift }
}

/// A number with so many digits after the point and a true minus sign.
pub fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", value.abs());
    let is_negative = value < 0.0 && text.bytes().any(|digit| (b'1'..=b'9').contains(&digit));
    if is_negative { format!("−{text}") } else { text }
}

/// A number with `digits` significant digits, trailing zeros kept; powers of ten where it is very large or small.
pub fn significant(value: f64, digits: usize) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let scientific = format!("{:.*e}", digits - 1, value.abs());
    let (mantissa, exponent) = scientific.split_once('e').expect("the form `e` has an exponent");
    let exponent: i32 = exponent.parse().expect("an exponent is an integer");
    if (-4..6).contains(&exponent) {
        return fixed(value, (digits as i32 - 1 - exponent).max(0) as usize);
    }
    let sign = if value < 0.0 { "−" } else { "" };
    format!("{sign}{mantissa}×10{}", superscript(exponent))
}

/// An integer in raised digits.
pub fn superscript(number: i32) -> String {
    number
        .to_string()
        .chars()
        .map(|digit| match digit {
            '-' => '⁻',
            '1' => '¹',
            '2' => '²',
            '3' => '³',
            '4' => '⁴',
            '5' => '⁵',
            '6' => '⁶',
            '7' => '⁷',
            '8' => '⁸',
            '9' => '⁹',
            _ => '⁰',
        })
        .collect()
}

/// The data's own values as labels, where there are few and they are whole; powers of ten are then no news.
fn own_ticks(span: Span, own: &[f64]) -> Option<Ticks> {
    let mut values: Vec<f64> = own.iter().copied().filter(|value| span.contains(*value)).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    let is_few = (2..=14).contains(&values.len()) && values.iter().all(|value| value.fract() == 0.0 && *value < 1e6);
    is_few.then(|| {
        let major = values.into_iter().map(|value| Tick { value, label: fixed(value, 0) }).collect();
        Ticks { major, ..Ticks::default() }
    })
}

fn logarithmic_ticks(span: Span, count: f64) -> Ticks {
    let decades = elementary::log10(span.high / span.low);
    if decades < 0.7 {
        return Ticks { minor: Vec::new(), ..linear_ticks(span, count, false) };
    }
    let [first, last] = [span.low, span.high].map(|bound| elementary::log10(bound).floor() as i32);
    let all = (first..=last).flat_map(|exponent| (1..10).map(move |digit| (digit, exponent)));
    let inside: Vec<(i32, i32)> = all.filter(|(digit, exponent)| span.contains(f64::from(*digit) * power_of_ten(*exponent))).collect();
    // Powers of ten alone from three decades on; each second, third, … where there are many.
    let stride = (decades / count.max(1.0)).ceil().max(1.0) as i32;
    let digits: &[i32] = if decades >= 2.9 || count < 4.0 || count < 2.0 * decades {
        &[1]
    } else if decades >= 1.3 {
        &[1, 3]
    } else {
        &[1, 2, 5]
    };
    let is_major = |(digit, exponent): &(i32, i32)| digits.contains(digit) && exponent.rem_euclid(stride) == 0;
    let is_plain = inside.iter().filter(|tick| is_major(tick)).all(|(_, exponent)| (-3..=4).contains(exponent));
    let value = |(digit, exponent): &(i32, i32)| f64::from(*digit) * power_of_ten(*exponent);
    let label = |tick: &(i32, i32)| match tick {
        (_, exponent) if is_plain => fixed(value(tick), (-exponent).max(0) as usize),
        (1, exponent) => format!("10{}", superscript(*exponent)),
        (digit, exponent) => format!("{digit}×10{}", superscript(*exponent)),
    };
    let major = inside.iter().filter(|tick| is_major(tick)).map(|tick| Tick { value: value(tick), label: label(tick) }).collect();
    let minor = inside.iter().filter(|tick| !is_major(tick) && (stride == 1 || tick.0 == 1)).map(value).collect();
    Ticks { major, minor, exponent: 0 }
}

/// What stands beside the axis: its label, its unit, and the power of ten of its numbers.
pub fn title(axis: &Axis, exponent: i32) -> String {
    let unit = unit_sign(&axis.unit);
    let measure = match (exponent, unit.is_empty()) {
        (0, _) => unit,
        (_, true) => format!("10{}", superscript(exponent)),
        (_, false) => format!("10{} {unit}", superscript(exponent)),
    };
    match (axis.label.is_empty(), measure.is_empty()) {
        (_, true) => axis.label.clone(),
        (true, false) => measure,
        (false, false) => format!("{} ({measure})", axis.label),
    }
}

/// A unit as readers write it.
pub fn unit_sign(unit: &str) -> String {
    match unit {
        "deg" => "°".into(),
        "1/sr" => "sr⁻¹".into(),
        "1/deg" => "°⁻¹".into(),
        "W/m2" => "W/m²".into(),
        "percent" => "%".into(),
        other => other.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(scale: Scale, unit: &str) -> Axis {
        Axis { label: "angle".into(), unit: unit.into(), scale, range: None, categories: Vec::new() }
    }

    fn labels(axis: &Axis, low: f64, high: f64, count: f64, own: &[f64]) -> Vec<String> {
        let span = Span { scale: axis.scale, low, high };
        ticks(axis, span, count, own).major.into_iter().map(|tick| tick.label).collect()
    }

    #[test]
    fn linear_labels_are_round() {
        let plain = axis(Scale::Linear, "");
        assert_eq!(labels(&plain, 0.0, 1.0, 5.0, &[]), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(&plain, -1.0, 1.0, 4.0, &[]), ["−1.0", "−0.5", "0.0", "0.5", "1.0"]);
        assert_eq!(labels(&plain, 0.0, 512.0, 6.0, &[]), ["0", "100", "200", "300", "400", "500"]);
        assert_eq!(labels(&axis(Scale::Linear, "deg"), 0.0, 90.0, 6.0, &[]), ["0", "15", "30", "45", "60", "75", "90"]);
    }

    #[test]
    fn small_numbers_share_a_power_of_ten() {
        let plain = axis(Scale::Linear, "1/sr");
        let found = ticks(&plain, Span { scale: Scale::Linear, low: 0.0, high: 8e-4 }, 4.0, &[]);
        assert_eq!(found.exponent, -4);
        assert_eq!(found.major.iter().map(|tick| tick.label.as_str()).collect::<Vec<_>>(), ["0", "2", "4", "6", "8"]);
        assert_eq!(title(&plain, -4), "angle (10⁻⁴ sr⁻¹)");
    }

    #[test]
    fn decades_are_written_plainly_or_as_powers() {
        let logarithmic = axis(Scale::Logarithmic, "");
        assert_eq!(labels(&logarithmic, 0.01, 10.0, 6.0, &[]), ["0.01", "0.1", "1", "10"]);
        assert_eq!(labels(&logarithmic, 1e-6, 1e-2, 6.0, &[]), ["10⁻⁶", "10⁻⁵", "10⁻⁴", "10⁻³", "10⁻²"]);
        assert_eq!(labels(&logarithmic, 0.1, 1.0, 6.0, &[]), ["0.1", "0.2", "0.5", "1"]);
        assert_eq!(labels(&logarithmic, 0.005, 0.9, 6.0, &[]), ["0.01", "0.03", "0.1", "0.3"]);
    }

    #[test]
    fn counts_in_powers_of_two_are_their_own_labels() {
        let logarithmic = axis(Scale::Logarithmic, "");
        assert_eq!(labels(&logarithmic, 60.0, 1100.0, 6.0, &[64.0, 256.0, 64.0, 1024.0]), ["64", "256", "1024"]);
    }

    #[test]
    fn an_axis_reaches_to_zero_where_the_data_come_near() {
        let reach = Reach { margin: 0.05, is_from_zero: true };
        let near = span(&axis(Scale::Linear, ""), [0.1, 1.0].into_iter(), reach);
        assert_eq!((near.low, near.high), (0.0, 1.05));
        let far = span(&axis(Scale::Linear, ""), [10.0, 11.0].into_iter(), reach);
        assert_eq!((far.low, far.high), (9.95, 11.05));
    }

    #[test]
    fn nothing_to_show_and_a_single_value_have_a_range_too() {
        for scale in [Scale::Linear, Scale::Logarithmic] {
            for data in [vec![], vec![3.0], vec![0.0], vec![-1.0]] {
                let span = span(&axis(scale, ""), data.clone().into_iter(), Reach { margin: 0.0, is_from_zero: false });
                assert!(span.low < span.high, "{data:?}");
                assert!(!ticks(&axis(scale, ""), span, 5.0, &[]).major.is_empty(), "{data:?} {span:?}");
            }
        }
    }

    #[test]
    fn significant_digits_are_kept() {
        assert_eq!(significant(54.462_322, 4), "54.46");
        assert_eq!(significant(-0.498_2, 3), "−0.498");
        assert_eq!(significant(1234567.0, 3), "1.23×10⁶");
        assert_eq!(significant(0.1, 2), "0.10");
    }
}
