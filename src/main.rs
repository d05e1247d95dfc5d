//! The command `pipeline`; everything is in the room `cli`.

fn main() -> std::process::ExitCode {
    pipeline::cli::main()
}
