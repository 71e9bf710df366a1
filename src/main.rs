//! The `meldscope` program; see [`meldscope::cli`].

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() {
    meldscope::cli::main()
}
