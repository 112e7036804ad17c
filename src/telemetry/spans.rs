//! What `tracing` calls a span, as OpenTelemetry has it: those of the learner and of actors, with their fields. A field
//! `trace.own` names the span itself and `trace.parent` one of another process, both as W3C Trace Context writes them.

use std::fmt::Debug;
use std::sync::Arc;
use std::time::SystemTime;

use opentelemetry::trace::{
    SpanContext, SpanId, SpanKind, Status, TraceFlags, TraceId, TraceState,
};
use opentelemetry::{InstrumentationScope, KeyValue};
use opentelemetry_sdk::trace::{
    BatchSpanProcessor, IdGenerator as _, RandomIdGenerator, SpanData, SpanEvents, SpanLinks,
    SpanProcessor as _,
};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id};
use tracing::{Metadata, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

/// The crates whose spans are recorded.
const RECORDED: [&str; 2] = ["actor", "learner"];

/// Hands spans to their processor when they end.
pub(super) struct Spans {
    processor: Arc<BatchSpanProcessor>,
}

/// Where a span stands: its trace and itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    trace: TraceId,
    span: SpanId,
}

/// A span that has not ended.
struct Open {
    place: Place,
    parent: SpanId,
    parent_is_remote: bool,
    begun: SystemTime,
    attributes: Vec<KeyValue>,
}

/// What stands in a span's fields.
#[derive(Default)]
struct Fields {
    own: Option<Place>,
    parent: Option<Place>,
    attributes: Vec<KeyValue>,
}

impl Spans {
    pub(super) fn new(processor: Arc<BatchSpanProcessor>) -> Self {
        Self { processor }
    }

    /// Whether a span is one of the learner's or of an actor's.
    pub(super) fn records(metadata: &Metadata<'_>) -> bool {
        let owner = metadata.target().split("::").next();
        metadata.is_span() && owner.is_some_and(|owner| RECORDED.contains(&owner))
    }
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Spans {
    fn on_new_span(&self, attributes: &Attributes<'_>, id: &Id, context: Context<'_, S>) {
        let span = context.span(id).expect("a span that begins is in the registry");
        let mut fields = Fields::default();
        attributes.record(&mut fields);
        let enclosing = span.parent();
        let enclosing =
            enclosing.and_then(|span| span.extensions().get::<Open>().map(|open| open.place));
        span.extensions_mut().insert(Open::begin(fields, enclosing));
    }

    fn on_close(&self, id: Id, context: Context<'_, S>) {
        let span = context.span(&id).expect("a span that ends is in the registry");
        if let Some(open) = span.extensions_mut().remove::<Open>() {
            self.processor.on_end(open.end(span.name()));
        }
    }
}

impl Open {
    /// Within the span that encloses it here, or its parent elsewhere, or in a trace of its own.
    fn begin(fields: Fields, enclosing: Option<Place>) -> Self {
        let Fields { own, parent, attributes } = fields;
        let outer = enclosing.or(parent);
        let ids = RandomIdGenerator::default();
        let place = own.unwrap_or_else(|| Place {
            trace: outer.map_or_else(|| ids.new_trace_id(), |outer| outer.trace),
            span: ids.new_span_id(),
        });
        Self {
            place,
            parent: outer.map_or(SpanId::INVALID, |outer| outer.span),
            parent_is_remote: enclosing.is_none() && parent.is_some(),
            begun: SystemTime::now(),
            attributes,
        }
    }

    fn end(self, name: &'static str) -> SpanData {
        let Place { trace, span } = self.place;
        let (flags, state) = (TraceFlags::SAMPLED, TraceState::default());
        SpanData {
            span_context: SpanContext::new(trace, span, flags, false, state),
            parent_span_id: self.parent,
            parent_span_is_remote: self.parent_is_remote,
            span_kind: SpanKind::Internal,
            name: name.into(),
            start_time: self.begun,
            end_time: SystemTime::now(),
            attributes: self.attributes,
            dropped_attributes_count: 0,
            events: SpanEvents::default(),
            links: SpanLinks::default(),
            status: Status::Unset,
            instrumentation_scope: InstrumentationScope::builder("s2mia").build(),
        }
    }
}

impl Place {
    /// `00-TRACE-SPAN-FLAGS`; `None` for anything else.
    fn read(text: &str) -> Option<Self> {
        let mut parts = text.split('-');
        let (Some("00"), Some(trace), Some(span)) = (parts.next(), parts.next(), parts.next())
        else {
            return None;
        };
        let place =
            Self { trace: TraceId::from_hex(trace).ok()?, span: SpanId::from_hex(span).ok()? };
        let whole = place.trace != TraceId::INVALID && place.span != SpanId::INVALID;
        whole.then_some(place)
    }
}

impl Visit for Fields {
    fn record_u64(&mut self, field: &Field, value: u64) {
        // OpenTelemetry's whole numbers are signed.
        let value = i64::try_from(value).unwrap_or(i64::MAX);
        self.attributes.push(KeyValue::new(field.name(), value));
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            "trace.own" => self.own = Place::read(value),
            "trace.parent" => self.parent = Place::read(value),
            name => self.attributes.push(KeyValue::new(name, value.to_owned())),
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.attributes.push(KeyValue::new(field.name(), format!("{value:?}")));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ELSEWHERE: &str = "00-00000000000000080000000000000abc-0000000000000abc-01";

    #[test]
    fn a_span_stands_within_the_one_that_another_process_names() {
        let parent = Place::read(ELSEWHERE);
        let open = Open::begin(Fields { parent, ..Fields::default() }, None);
        let place = parent.expect("it is written as it should be");
        assert_eq!((open.place.trace, open.parent), (place.trace, place.span));
        assert!(open.parent_is_remote && open.place.span != place.span);
    }

    #[test]
    fn what_is_no_trace_context_is_passed_over() {
        let void = "00-00000000000000000000000000000000-0000000000000abc-01";
        for text in ["", "00", "ff-1-2-3", void, &ELSEWHERE[..40]] {
            assert_eq!(Place::read(text), None, "{text}");
        }
        let open = Open::begin(Fields::default(), None);
        assert_eq!(open.parent, SpanId::INVALID);
    }
}
