//! Wall time, processor time and medians.

use std::time::Instant;

/// Duration of some work, seconds. Other programs on the same cores affect only the wall time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Took {
    /// Wall time.
    pub(crate) wall: f64,
    /// Processor time of all threads of this process.
    pub(crate) process: f64,
    /// Processor time of the calling thread.
    pub(crate) thread: f64,
}

/// Measures `work` once.
pub(crate) fn once<T>(work: impl FnOnce() -> T) -> (T, Took) {
    let (begin, process, thread) = (Instant::now(), process_secs(), thread_secs());
    let result = work();
    let took = Took {
        wall: begin.elapsed().as_secs_f64(),
        process: process_secs() - process,
        thread: thread_secs() - thread,
    };
    (result, took)
}

/// Medians of `repeats` measurements, after one uncounted run.
pub(crate) fn typical(repeats: usize, mut work: impl FnMut()) -> Took {
    work();
    let times: Vec<Took> = (0..repeats).map(|_| once(&mut work).1).collect();
    let of = |clock: fn(&Took) -> f64| median(times.iter().map(clock));
    Took {
        wall: of(|took| took.wall),
        process: of(|took| took.process),
        thread: of(|took| took.thread),
    }
}

/// The median, or the upper of the two middle values. NaN if there are none.
pub(crate) fn median(numbers: impl IntoIterator<Item = f64>) -> f64 {
    let mut numbers: Vec<f64> = numbers.into_iter().collect();
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Processor time of all threads of this process so far, seconds.
pub(crate) fn process_secs() -> f64 {
    read(libc::CLOCK_PROCESS_CPUTIME_ID)
}

/// Processor time of the calling thread so far, seconds.
pub(crate) fn thread_secs() -> f64 {
    read(libc::CLOCK_THREAD_CPUTIME_ID)
}

#[expect(unsafe_code, reason = "the standard library has no processor clock")]
fn read(clock: libc::clockid_t) -> f64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `now` is a timespec that outlives the call, which writes nothing else.
    let status = unsafe { libc::clock_gettime(clock, &raw mut now) };
    assert_eq!(status, 0, "POSIX has this clock");
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}
