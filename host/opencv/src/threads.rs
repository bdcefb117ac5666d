//! Calls of OpenCV: by one thread, and with enough stack.

use std::sync::LazyLock;

use crate::OpencvError;

/// Calls OpenCV's function `name`.
pub fn call<T>(name: &'static str, work: impl FnOnce() -> opencv::Result<T>) -> Result<T, OpencvError> {
    ONE_THREAD.clone()?;
    work().map_err(|error| exception(name, &error))
}

/// Stack size of the calibrations: OpenBLAS, which many machines use instead of the reference BLAS, puts work space on
/// the stack that exceeds the usual 2 to 8 MiB.
const STACK: usize = 64 << 20;

/// Calls OpenCV's function `name` in a thread with a large stack.
pub fn call_with_large_stack<T: Send>(
    name: &'static str,
    work: impl FnOnce() -> opencv::Result<T> + Send,
) -> Result<T, OpencvError> {
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, || call(name, work));
        let thread = thread.map_err(|error| OpencvError::Exception { call: name, message: error.to_string() })?;
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

fn exception(call: &'static str, error: &opencv::Error) -> OpencvError {
    OpencvError::Exception { call, message: error.message.trim().to_owned() }
}

static ONE_THREAD: LazyLock<Result<(), OpencvError>> = LazyLock::new(|| {
    use_one_thread_in_blas();
    opencv::core::set_num_threads(1).map_err(|error| exception("setNumThreads", &error))
});

/// OpenCV solves its equations with the BLAS of the system. OpenBLAS divides even small ones among threads, which wait
/// longer than they compute, and the last bits of the result depend on their number.
#[cfg(unix)]
#[allow(unsafe_code, reason = "a function that only OpenBLAS has is found by its name")]
fn use_one_thread_in_blas() {
    // SAFETY: the name ends with a zero.
    let function = unsafe { libc::dlsym(libc::RTLD_DEFAULT, c"openblas_set_num_threads".as_ptr()) };
    if !function.is_null() {
        // SAFETY: OpenBLAS declares `void openblas_set_num_threads(int)`.
        let set = unsafe { std::mem::transmute::<*mut libc::c_void, extern "C" fn(libc::c_int)>(function) };
        set(1);
    }
}

#[cfg(not(unix))]
fn use_one_thread_in_blas() {}
