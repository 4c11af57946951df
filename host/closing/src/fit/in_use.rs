//! What states of a model share as long as one of them uses it.

use std::sync::{Arc, Mutex, PoisonError, Weak};

/// Values that are in use, each with what it was made for. Nothing is kept that nobody uses.
pub(crate) struct InUse<K, T: ?Sized>(Mutex<Vec<(K, Weak<T>)>>);

impl<K, T: ?Sized> Default for InUse<K, T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<K, T: ?Sized> InUse<K, T> {
    /// The first value in use that is the wanted one.
    pub(crate) fn find(&self, is_wanted: impl Fn(&K, &T) -> bool) -> Option<Arc<T>> {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.iter().find_map(|(key, value)| value.upgrade().filter(|value| is_wanted(key, value)))
    }

    /// Adds a value, which was made without any lock.
    pub(crate) fn add(&self, key: K, value: &Arc<T>) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|(_, value)| value.strong_count() > 0);
        all.push((key, Arc::downgrade(value)));
    }
}
