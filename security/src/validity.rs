//! The validity period of a certificate, read from its DER bytes. rustls verifies certificates of peers; this check
//! gives the reason before a peer refuses an expired certificate of this program.

use std::fmt;
use std::time::SystemTime;

use time::{Date, OffsetDateTime, Time};

const SEQUENCE: u8 = 0x30;
const VERSION: u8 = 0xa0;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;

/// A time in UTC: year, month, day, hour, minute, second. Later times compare as larger.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Moment([u32; 6]);

/// Validity period of a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Validity {
    pub(crate) from: Moment,
    pub(crate) until: Moment,
}

impl Moment {
    /// Seconds since 1970; `None` for a date that no calendar has.
    pub(crate) fn unix_secs(self) -> Option<i64> {
        let [year, month, day, hour, minute, second] = self.0;
        let [month, day, hour, minute, second] =
            [month, day, hour, minute, second].map(|field| u8::try_from(field).ok());
        let month = time::Month::try_from(month?).ok()?;
        let date = Date::from_calendar_date(i32::try_from(year).ok()?, month, day?).ok()?;
        let time = Time::from_hms(hour?, minute?, second?).ok()?;
        Some(OffsetDateTime::new_utc(date, time).unix_timestamp())
    }
}

impl Validity {
    /// Validity of a certificate in DER form; `None` if it is invalid.
    pub(crate) fn of(certificate: &[u8]) -> Option<Self> {
        let (_, certificate, _) = element(certificate)?;
        let (_, mut rest, _) = element(certificate)?;
        if rest.first() == Some(&VERSION) {
            rest = element(rest)?.2;
        }
        // Serial number, signature algorithm and issuer precede it (RFC 5280, section 4.1).
        for _ in 0..3 {
            rest = element(rest)?.2;
        }
        let (tag, times, _) = element(rest)?;
        let (from, until) = (moment(times)?, moment(element(times)?.2)?);
        (tag == SEQUENCE).then_some(Self { from, until })
    }
}

/// The first element of `bytes`: its tag, its content, and what follows it.
fn element(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&tag, rest) = bytes.split_first()?;
    let (&first, rest) = rest.split_first()?;
    let (length, rest) = match first {
        0..=0x7f => (usize::from(first), rest),
        0x81..=0x84 => {
            let (digits, rest) = rest.split_at_checked(usize::from(first & 0x7f))?;
            (digits.iter().fold(0, |length, digit| (length << 8) | usize::from(*digit)), rest)
        }
        _ => return None,
    };
    let (content, rest) = rest.split_at_checked(length)?;
    Some((tag, content, rest))
}

/// Parses `YYMMDDHHMMSSZ`, in which years from 50 are 19YY, or `YYYYMMDDHHMMSSZ`.
fn moment(bytes: &[u8]) -> Option<Moment> {
    let (tag, text, _) = element(bytes)?;
    let digits = std::str::from_utf8(text.strip_suffix(b"Z")?).ok()?;
    let (year, rest) = match tag {
        UTC_TIME => digits.split_at_checked(2)?,
        GENERALIZED_TIME => digits.split_at_checked(4)?,
        _ => return None,
    };
    let century = match (tag, year.parse().ok()?) {
        (UTC_TIME, 50_u32..) => 1900,
        (UTC_TIME, _) => 2000,
        _ => 0,
    };
    let mut fields = [century + year.parse::<u32>().ok()?, 0, 0, 0, 0, 0];
    for (index, field) in fields.iter_mut().enumerate().skip(1) {
        *field = rest.get(2 * (index - 1)..2 * index)?.parse().ok()?;
    }
    Some(Moment(fields))
}

impl From<SystemTime> for Moment {
    /// The time in UTC.
    fn from(time: SystemTime) -> Self {
        let time = OffsetDateTime::from(time);
        let ((year, month, day), (hour, minute, second)) = (time.to_calendar_date(), time.to_hms());
        let fields = [month.into(), day, hour, minute, second].map(u32::from);
        let [month, day, hour, minute, second] = fields;
        Self([year.unsigned_abs(), month, day, hour, minute, second])
    }
}

impl fmt::Display for Moment {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [year, month, day, hour, minute, second] = self.0;
        write!(formatter, "{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC")
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn at(unix_secs: u64) -> Moment {
        Moment::from(SystemTime::UNIX_EPOCH + Duration::from_secs(unix_secs))
    }

    #[test]
    fn seconds_since_1970_become_the_dates_of_the_calendar() {
        for (seconds, date) in [
            (0, "1970-01-01 00:00:00 UTC"),
            (951_782_400, "2000-02-29 00:00:00 UTC"),
            (1_000_000_000, "2001-09-09 01:46:40 UTC"),
            (4_107_542_399, "2100-02-28 23:59:59 UTC"),
            (4_107_542_400, "2100-03-01 00:00:00 UTC"),
        ] {
            assert_eq!(at(seconds).to_string(), date);
            assert_eq!(at(seconds).unix_secs(), i64::try_from(seconds).ok());
        }
    }

    #[test]
    fn both_forms_of_a_time_are_read() {
        let utc = [&[UTC_TIME, 13], b"010909014640Z".as_slice()].concat();
        let old = [&[UTC_TIME, 13], b"990909014640Z".as_slice()].concat();
        let general = [&[GENERALIZED_TIME, 15], b"20010909014640Z".as_slice()].concat();
        assert_eq!(moment(&utc), Some(at(1_000_000_000)));
        assert_eq!(moment(&general), Some(at(1_000_000_000)));
        assert_eq!(moment(&old).map(|moment| moment.0[0]), Some(1999));
        assert_eq!(moment(&[UTC_TIME, 3, b'1', b'2', b'Z']), None);
        let none = [&[UTC_TIME, 13], b"010231000000Z".as_slice()].concat();
        assert_eq!(moment(&none).and_then(Moment::unix_secs), None);
    }

    #[test]
    fn lengths_past_the_end_are_no_element() {
        assert_eq!(element(&[SEQUENCE, 2, 7]), None);
        assert_eq!(element(&[SEQUENCE, 0x84, 0xff, 0xff, 0xff, 0xff]), None);
        assert_eq!(element(&[SEQUENCE, 0x81, 1, 7, 9]), Some((SEQUENCE, &[7][..], &[9][..])));
        assert_eq!(Validity::of(b"no certificate"), None);
    }
}
