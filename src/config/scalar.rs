//! One value of a configuration. Every setting is a scalar, so that each can be set as `key.path=value`.

use std::fmt;

/// A value; its kind is that of the default in `configs/base.toml`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Scalar {
    /// `true` or `false`.
    Boolean(bool),
    /// A whole number.
    Integer(i64),
    /// A finite number.
    Float(f64),
    /// Text.
    Text(String),
}

/// Whole numbers up to this size are exact as `f64`.
const EXACT_INTEGER: f64 = 9_007_199_254_740_992.0;

impl Scalar {
    /// The scalar in a TOML value; `None` for tables, arrays and dates.
    pub(crate) fn from_toml(value: &toml::Value) -> Option<Self> {
        match value {
            toml::Value::Boolean(flag) => Some(Self::Boolean(*flag)),
            toml::Value::Integer(number) => Some(Self::Integer(*number)),
            toml::Value::Float(number) => Some(Self::Float(*number)),
            toml::Value::String(text) => Some(Self::Text(text.clone())),
            _ => None,
        }
    }

    /// The value as the crates' serde types read it.
    pub(crate) fn to_toml(&self) -> toml::Value {
        match self {
            Self::Boolean(flag) => toml::Value::Boolean(*flag),
            Self::Integer(number) => toml::Value::Integer(*number),
            Self::Float(number) => toml::Value::Float(*number),
            Self::Text(text) => toml::Value::String(text.clone()),
        }
    }

    /// The kind of value that can replace this default, for messages.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Boolean(_) => "true or false",
            Self::Integer(_) => "a whole number",
            Self::Float(_) => "a finite number",
            Self::Text(_) => "text",
        }
    }

    /// This value in the kind of `default`: `5` is a number, `1e6` a whole one. `None` if it does not fit.
    pub(crate) fn fitted(self, default: &Self) -> Option<Self> {
        match (self, default) {
            (Self::Integer(number), Self::Float(_)) => Some(Self::Float(number as f64)),
            (Self::Float(number), Self::Integer(_)) => {
                let whole = number.fract() == 0.0 && number.abs() <= EXACT_INTEGER;
                whole.then_some(Self::Integer(number as i64))
            }
            (Self::Float(number), Self::Float(_)) => {
                number.is_finite().then_some(Self::Float(number))
            }
            (value, default) => {
                let same = std::mem::discriminant(&value) == std::mem::discriminant(default);
                same.then_some(value)
            }
        }
    }

    /// Parses the right side of `key=value`; quotes around text are optional.
    pub(crate) fn parse(text: &str, default: &Self) -> Option<Self> {
        let written = written_value(text);
        match default {
            Self::Text(_) => match written {
                Some(Self::Text(quoted)) => Some(Self::Text(quoted)),
                _ => Some(Self::Text(text.to_owned())),
            },
            _ => written?.fitted(default),
        }
    }
}

/// A scalar in TOML notation.
fn written_value(text: &str) -> Option<Scalar> {
    let table: toml::Table = format!("value = {text}").parse().ok()?;
    (table.len() == 1).then(|| Scalar::from_toml(&table["value"])).flatten()
}

impl fmt::Display for Scalar {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.to_toml().fmt(formatter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_and_floats_take_each_other_where_nothing_is_lost() {
        assert_eq!(Scalar::Integer(5).fitted(&Scalar::Float(0.0)), Some(Scalar::Float(5.0)));
        assert_eq!(
            Scalar::Float(1e6).fitted(&Scalar::Integer(0)),
            Some(Scalar::Integer(1_000_000))
        );
        assert_eq!(Scalar::Float(1.5).fitted(&Scalar::Integer(0)), None);
        assert_eq!(Scalar::Float(1e300).fitted(&Scalar::Integer(0)), None);
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        assert_eq!(Scalar::parse("nan", &Scalar::Float(0.0)), None);
        assert_eq!(Scalar::parse("inf", &Scalar::Float(0.0)), None);
    }

    #[test]
    fn text_needs_no_quotes_on_the_command_line() {
        let default = Scalar::Text(String::new());
        assert_eq!(Scalar::parse("gru", &default), Some(Scalar::Text("gru".into())));
        assert_eq!(Scalar::parse("\"gru\"", &default), Some(Scalar::Text("gru".into())));
        assert_eq!(Scalar::parse("7", &default), Some(Scalar::Text("7".into())));
        assert_eq!(Scalar::parse("", &default), Some(Scalar::Text(String::new())));
    }

    #[test]
    fn a_value_cannot_smuggle_in_a_second_key() {
        assert_eq!(Scalar::parse("1\nother = 2", &Scalar::Integer(0)), None);
    }
}
