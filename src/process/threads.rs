//! A limit of processes and threads: libraries panic when they cannot start a thread. The program reports it as an
//! error instead.

use crate::process::output;

/// The beginnings of these panics: of tokio, of the standard library and of rayon.
const PANICS: [&str; 3] = [
    "OS can't spawn worker thread",
    "failed to spawn thread",
    "The global thread pool has not been initialized",
];

/// Replaces the report of such a panic by one line. In the main thread it ends the program with status 1.
pub(crate) fn report_limit() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !panic.payload_as_str().is_some_and(is_limit) {
            return report(panic);
        }
        let advice = "raise the limit of processes and threads (`ulimit -u`, or the container's)";
        output::error(format!("error: cannot start a thread; {advice}"));
        if std::thread::current().name() == Some("main") {
            std::process::exit(1);
        }
    }));
}

fn is_limit(panic: &str) -> bool {
    PANICS.iter().any(|known| panic.starts_with(known))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::runtime::Builder;

    /// No address space has room for the stack of a thread.
    const STACK_BYTES: usize = 1 << 47;

    #[test]
    fn the_panic_of_a_runtime_that_gets_no_thread_is_known() {
        let start =
            || Builder::new_multi_thread().worker_threads(1).thread_stack_size(STACK_BYTES).build();
        let panic = std::panic::catch_unwind(start).unwrap_err();
        let text = panic.downcast_ref::<String>().unwrap();
        assert!(is_limit(text), "{text}");
    }
}
