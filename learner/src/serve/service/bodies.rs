//! Limits the memory of request bodies. Most calls send one small message. Result streams share one budget; when it is
//! exceeded, streams that hold more than an equal share are ended.

use std::error::Error;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};

use bytes::Bytes;
use http_body_util::{BodyExt as _, LengthLimitError, Limited};
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use proto::{Reason, Refusal};
use tonic::body::Body;
use tonic::codegen::http::Request;
use tonic::{Code, Status};
use tower::util::MapRequestLayer;

/// Largest request of a unary call, bytes, unless a registration needs more.
const MOST_REQUEST_BYTES: usize = 256 << 10;
/// Budget of unprocessed result bytes, over all streams.
const MOST_IN_FLIGHT_BYTES: usize = 512 << 20;
/// Other calls with streamed requests.
const STREAMS: [&str; 2] = ["/Act", "/ServerReflectionInfo"];
/// The call whose messages are large.
const RESULTS: &str = "/PushTrajectory";

/// A layer that limits the bodies of all requests. A registration names every feature of the environment, whose description
/// has `environment_bytes`, and as much again is left for everything else.
pub(super) fn limits(
    environment_bytes: usize,
) -> MapRequestLayer<impl Fn(Request<Body>) -> Request<Body> + Clone> {
    let budget = Budget::of(MOST_IN_FLIGHT_BYTES);
    let most = MOST_REQUEST_BYTES.max(environment_bytes.saturating_mul(2));
    MapRequestLayer::new(move |request| budget.limit(request, most))
}

/// The status of a request with more than `most` bytes, which tonic gives to messages above its own limit, too.
fn too_large(most: usize) -> Status {
    let detail = format!("the request has more than {most} bytes");
    let refusal = Status::from(Refusal::new(Reason::TooLarge, "message", detail));
    let details = Bytes::copy_from_slice(refusal.details());
    Status::with_details(Code::OutOfRange, refusal.message(), details)
}

/// The budget of all result streams.
#[derive(Debug)]
struct Budget {
    most: usize,
    held: AtomicUsize,
    streams: AtomicUsize,
}

/// The part of the budget that one stream holds.
#[derive(Debug)]
pub(super) struct Share {
    budget: Arc<Budget>,
    held: AtomicUsize,
}

impl Budget {
    fn of(most: usize) -> Arc<Self> {
        Arc::new(Self { most, held: AtomicUsize::new(0), streams: AtomicUsize::new(0) })
    }

    fn share(self: &Arc<Self>) -> Arc<Share> {
        self.streams.fetch_add(1, Ordering::Relaxed);
        Arc::new(Share { budget: Arc::clone(self), held: AtomicUsize::new(0) })
    }

    /// Limits the body of one request; that of a unary call to `most` bytes.
    fn limit(self: &Arc<Self>, mut request: Request<Body>, most: usize) -> Request<Body> {
        let path = request.uri().path();
        if path.ends_with(RESULTS) {
            let share = self.share();
            request.extensions_mut().insert(Arc::clone(&share));
            return request.map(|body| Body::new(Counted { body, share }));
        }
        if STREAMS.iter().any(|stream| path.ends_with(stream)) {
            return request;
        }
        let refused = move |error: Box<dyn Error + Send + Sync>| {
            if error.is::<LengthLimitError>() { too_large(most) } else { Status::from_error(error) }
        };
        request.map(|body| Body::new(Limited::new(body, most).map_err(refused)))
    }
}

impl Share {
    /// Adds received bytes.
    ///
    /// # Errors
    /// The budget is exceeded, and this stream holds more than an equal share.
    fn take(&self, bytes: usize) -> Result<(), Status> {
        let own = self.held.fetch_add(bytes, Ordering::Relaxed) + bytes;
        let all = self.budget.held.fetch_add(bytes, Ordering::Relaxed) + bytes;
        let equal = self.budget.most / self.budget.streams.load(Ordering::Relaxed).max(1);
        if all <= self.budget.most || own <= equal {
            return Ok(());
        }
        let message = format!("{all} bytes of results are unprocessed, {own} from this stream");
        Err(Status::new(Code::Unavailable, message))
    }

    /// Releases all bytes received so far, after they have been processed.
    pub(super) fn processed(&self) {
        let held = self.held.swap(0, Ordering::Relaxed);
        self.budget.held.fetch_sub(held, Ordering::Relaxed);
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.processed();
        self.budget.streams.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A body that counts its bytes against a share.
struct Counted {
    body: Body,
    share: Arc<Share>,
}

impl HttpBody for Counted {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        polled.map(|next| {
            next.map(|frame| {
                let frame = frame?;
                self.share.take(frame.data_ref().map_or(0, Bytes::len))?;
                Ok(frame)
            })
        })
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_request_above_the_limit_is_refused_with_a_reason() {
        let status = async |bytes: usize| {
            let body = Body::new(http_body_util::Full::new(Bytes::from(vec![0; bytes])));
            let request = Request::builder().uri("/s2mia.v1.LearnerService/Register").body(body);
            let limited = Budget::of(1000).limit(request.unwrap(), 10);
            limited.into_body().collect().await.map(drop)
        };
        assert!(status(10).await.is_ok());
        let status = status(11).await.unwrap_err();
        assert_eq!(status.code(), Code::OutOfRange);
        assert!(
            status.message().ends_with("message: the request has more than 10 bytes"),
            "{status}"
        );
        assert!(!status.details().is_empty());
    }

    #[test]
    fn a_stream_ends_only_if_the_budget_is_exceeded_and_it_holds_more_than_an_equal_share() {
        let budget = Budget::of(1000);
        let (large, small) = (budget.share(), budget.share());
        assert!(large.take(900).is_ok() && small.take(100).is_ok());
        assert!(small.take(100).is_ok(), "it holds less than half");
        let status = large.take(100).unwrap_err();
        assert_eq!(status.code(), Code::Unavailable);
        drop(large);
        small.processed();
        assert_eq!(budget.held.load(Ordering::Relaxed), 0);
        assert!(small.take(1000).is_ok());
    }
}
