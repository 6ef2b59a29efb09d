//! Compiles the services' protocol buffers, without an external protoc.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto");
    #[cfg(feature = "grpc")]
    {
        let descriptors = protox::compile(["spherecal/v1/spherecal.proto"], ["proto"])?;
        // For reflection: the services describe themselves.
        let out = std::path::PathBuf::from(std::env::var_os("OUT_DIR").ok_or("no OUT_DIR")?);
        std::fs::write(out.join("spherecal.bin"), prost::Message::encode_to_vec(&descriptors))?;
        tonic_prost_build::configure().compile_fds(descriptors)?;
    }
    Ok(())
}
