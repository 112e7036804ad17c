//! One value of a configuration. Every setting is a scalar, so that each can be set as `key.path=value`; its kind is that of
//! the default in `configs/base.toml`.

use std::mem::discriminant;

use toml::Value;

/// Whole numbers up to this size are exact as `f64`.
const EXACT_INTEGER: f64 = 9_007_199_254_740_992.0;

/// The kind of value that can replace this default, for messages.
pub(super) fn kind(default: &Value) -> &'static str {
    match default {
        Value::Boolean(_) => "true or false",
        Value::Integer(_) => "a whole number",
        Value::Float(_) => "a finite number",
        _ => "text",
    }
}

/// `value` in the kind of `default`: `5` is a number, `1e6` a whole one. `None` if it does not fit.
pub(super) fn fitted(value: Value, default: &Value) -> Option<Value> {
    match (value, default) {
        (Value::Integer(number), Value::Float(_)) => Some(Value::Float(number as f64)),
        (Value::Float(number), Value::Integer(_)) => {
            let whole = number.fract() == 0.0 && number.abs() <= EXACT_INTEGER;
            whole.then_some(Value::Integer(number as i64))
        }
        (Value::Float(number), Value::Float(_)) => {
            number.is_finite().then_some(Value::Float(number))
        }
        (value, default) => (discriminant(&value) == discriminant(default)).then_some(value),
    }
}

/// The right side of `key=value` in the kind of `default`; quotes around text are optional.
pub(super) fn parsed(text: &str, default: &Value) -> Option<Value> {
    match (written(text), default) {
        (Some(quoted @ Value::String(_)), Value::String(_)) => Some(quoted),
        (_, Value::String(_)) => Some(Value::from(text)),
        (written, _) => fitted(written?, default),
    }
}

/// A value in TOML notation.
fn written(text: &str) -> Option<Value> {
    let mut table: toml::Table = format!("value = {text}").parse().ok()?;
    let value = table.remove("value");
    value.filter(|_| table.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use Value::{Float, Integer};

    #[test]
    fn whole_numbers_and_floats_take_each_other_where_nothing_is_lost() {
        assert_eq!(fitted(Integer(5), &Float(0.0)), Some(Float(5.0)));
        assert_eq!(fitted(Float(1e6), &Integer(0)), Some(Integer(1_000_000)));
        assert_eq!(fitted(Float(1.5), &Integer(0)), None);
        assert_eq!(fitted(Float(1e300), &Integer(0)), None);
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        assert_eq!(parsed("nan", &Float(0.0)), None);
        assert_eq!(parsed("inf", &Float(0.0)), None);
    }

    #[test]
    fn text_needs_no_quotes_on_the_command_line() {
        let default = Value::from("");
        assert_eq!(parsed("gru", &default), Some(Value::from("gru")));
        assert_eq!(parsed("\"gru\"", &default), Some(Value::from("gru")));
        assert_eq!(parsed("7", &default), Some(Value::from("7")));
        assert_eq!(parsed("", &default), Some(Value::from("")));
    }

    #[test]
    fn a_value_cannot_smuggle_in_a_second_key() {
        assert_eq!(parsed("1\nother = 2", &Integer(0)), None);
    }
}
