//! Spans of the learner and of actors for an OpenTelemetry collector, whose address stands in the variables that
//! OpenTelemetry's specification names. What is recorded changes nothing, and nothing waits for it.

mod spans;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use opentelemetry_otlp::SpanExporter as OtlpExporter;
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::trace::{BatchSpanProcessor, SpanData, SpanExporter, SpanProcessor as _};
use tokio::runtime::Runtime;
use tracing_subscriber::filter::FilterFn;
use tracing_subscriber::{Layer, Registry};

use crate::cli::Command;
use crate::telemetry::spans::Spans;

/// A collector is named by one of these.
const ENDPOINTS: [&str; 2] = ["OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT"];

/// How long the last spans have to reach the collector when the process ends: less than actors of a local run have to leave.
const FLUSH: Duration = Duration::from_secs(1);

/// Sends spans for as long as it lives, and the last ones when it is dropped.
pub(crate) struct Telemetry {
    processor: Arc<BatchSpanProcessor>,
    /// What the exporter's connection runs on, until it is dropped; the run has its own.
    runtime: Option<Runtime>,
}

impl Telemetry {
    /// Spans of a role of the run; `None` if no collector is named, or the command has none.
    ///
    /// # Errors
    /// If the variables name none that can be.
    pub(crate) fn start(command: &Command) -> anyhow::Result<Option<Self>> {
        let named = |name: &&str| std::env::var(name).ok().filter(|endpoint| !endpoint.is_empty());
        match service(command).zip(ENDPOINTS.iter().find_map(named)) {
            Some((service, endpoint)) => Self::to(endpoint, service).map(Some),
            None => Ok(None),
        }
    }

    fn to(endpoint: String, service: &'static str) -> anyhow::Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("telemetry")
            .enable_all()
            .build()
            .context("cannot start the thread that sends spans")?;
        let exporter = {
            let _inside = runtime.enter();
            OtlpExporter::builder().with_tonic().build()
        };
        let exporter = exporter.with_context(|| format!("cannot send spans to {endpoint}"))?;
        let mut exporter = Patient { exporter, endpoint, told: AtomicBool::new(false) };
        exporter.set_resource(&resource(service));
        // Its queue holds OTEL_BSP_MAX_QUEUE_SIZE spans, 2,048 by default; when it is full, more are dropped.
        let processor = Arc::new(BatchSpanProcessor::builder(exporter).build());
        Ok(Self { processor, runtime: Some(runtime) })
    }

    /// Where spans are handed in.
    pub(crate) fn spans(&self) -> impl Layer<Registry> + Send + Sync + use<> {
        Spans::new(Arc::clone(&self.processor)).with_filter(FilterFn::new(Spans::records))
    }
}

impl Drop for Telemetry {
    fn drop(&mut self) {
        if let Err(error) = self.processor.shutdown_with_timeout(FLUSH) {
            tracing::debug!("the last spans did not get away: {error}");
        }
        // A name that is still being looked up would be waited for otherwise.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// The roles of a run that record spans.
fn service(command: &Command) -> Option<&'static str> {
    match command {
        Command::Train(_) | Command::Learner(_) => Some("s2mia-learner"),
        Command::Actor(_) => Some("s2mia-actor"),
        _ => None,
    }
}

/// Who sends: what OTEL_SERVICE_NAME and OTEL_RESOURCE_ATTRIBUTES say, or the role.
fn resource(service: &'static str) -> Resource {
    match std::env::var("OTEL_SERVICE_NAME") {
        Ok(_) => Resource::builder().build(),
        Err(_) => Resource::builder().with_service_name(service).build(),
    }
}

/// Says once that spans do not get through, and no more.
#[derive(Debug)]
struct Patient<E> {
    exporter: E,
    endpoint: String,
    told: AtomicBool,
}

impl<E: SpanExporter> SpanExporter for Patient<E> {
    async fn export(&self, batch: Vec<SpanData>) -> OTelSdkResult {
        let sent = self.exporter.export(batch).await;
        if let Err(error) = &sent
            && !self.told.swap(true, Ordering::Relaxed)
        {
            let endpoint = &self.endpoint;
            tracing::warn!("spans do not reach {endpoint}: {error}; the run goes on without them");
        }
        sent
    }

    fn shutdown_with_timeout(&self, timeout: Duration) -> OTelSdkResult {
        self.exporter.shutdown_with_timeout(timeout)
    }

    fn set_resource(&mut self, resource: &Resource) {
        self.exporter.set_resource(resource);
    }
}
