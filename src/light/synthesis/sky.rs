//! placeholder
use crate::light::envmap::EnvMap;
/// placeholder
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SunSky;
impl SunSky {
    /// placeholder
    pub fn map<E: Send>(&self, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
        super::plain::constant([1.0; 3], width, check)
    }
}
