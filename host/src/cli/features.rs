//! Options whose feature this program was built without.
//!
//! Every command that takes such an option calls these checks first, so that it
//! refuses the option before it plans, moves or writes anything.

use spherecal_job::Link;
use spherecal_store::StoreLocation;

use super::args::{ProtectionArgs, RunArgs};
use super::exit::CliError;

/// Refuses what a run asks for and this program does not have.
/// Errors: the first option that needs a feature which is not there.
pub(super) fn check_run(args: &RunArgs) -> Result<(), CliError> {
    check_link(&args.link)?;
    check_store(args.store.as_ref())?;
    check_protection(&args.protection)?;
    let asked = [("--tracker", &args.tracker), ("--publish", &args.publish)];
    match asked.into_iter().find(|(_, peer)| peer.is_some()) {
        Some((option, _)) => services(option),
        None => Ok(()),
    }
}

/// Refuses a link to a service.
/// Errors: a link by gRPC without the feature `services`.
pub(super) fn check_link(link: &Link) -> Result<(), CliError> {
    match link {
        Link::Grpc(_) => services("--link grpc:"),
        _ => Ok(()),
    }
}

/// Refuses a kind of store.
/// Errors: a service without the feature `services`, PostgreSQL without `postgres`.
pub(super) fn check_store(store: Option<&StoreLocation>) -> Result<(), CliError> {
    match store {
        Some(StoreLocation::Service(_)) => services("--store grpc:"),
        Some(StoreLocation::Postgres(_)) if cfg!(not(feature = "postgres")) => {
            Err(CliError::feature("--store postgres:", "postgres"))
        }
        _ => Ok(()),
    }
}

/// Refuses TLS.
/// Errors: a certificate without the feature `services`.
pub(super) fn check_protection(protection: &ProtectionArgs) -> Result<(), CliError> {
    if protection.tls_cert.is_some() || protection.tls_key.is_some() {
        return services("--tls-cert");
    }
    Ok(())
}

/// Refuses an option that needs the feature `services`.
fn services(option: &str) -> Result<(), CliError> {
    if cfg!(feature = "services") {
        return Ok(());
    }
    Err(CliError::feature(option, "services"))
}
