//! Layers under the names that their parameters have in files.

use burn::module::{
    Content, Devices, Module, ModuleDisplay, ModuleDisplayDefault, ModuleMapper, ModuleVisitor,
};
use burn::tensor::Device;

/// Layers in the order of computation.
///
/// Burn names a parameter after the fields on the way to it. Here the names come from the architecture instead: the field
/// that holds the layers is named like the first part of their names, as in `trunk.conv1`.
#[derive(Clone, Debug)]
pub(crate) struct Layers<M> {
    /// Last part of each name, as `conv1`.
    names: Vec<String>,
    modules: Vec<M>,
}

impl<M> Layers<M> {
    pub(crate) fn modules(&self) -> &[M] {
        &self.modules
    }
}

impl<'a, M> FromIterator<(&'a str, M)> for Layers<M> {
    /// Collects layers with their full names.
    fn from_iter<I: IntoIterator<Item = (&'a str, M)>>(layers: I) -> Self {
        let last = |name: &str| name.rsplit('.').next().unwrap_or(name).to_owned();
        let (names, modules) = layers.into_iter().map(|(name, module)| (last(name), module)).unzip();
        Self { names, modules }
    }
}

const CONTAINER: &str = "Layers";

impl<M: Module> Module for Layers<M> {
    fn visit<V: ModuleVisitor>(&self, visitor: &mut V) {
        for (name, module) in self.names.iter().zip(&self.modules) {
            visitor.enter_module(name, CONTAINER);
            module.visit(visitor);
            visitor.exit_module(name, CONTAINER);
        }
    }

    fn map<A: ModuleMapper>(self, mapper: &mut A) -> Self {
        let Self { names, modules } = self;
        let map = |(name, module): (&String, M)| {
            mapper.enter_module(name, CONTAINER);
            let mapped = module.map(mapper);
            mapper.exit_module(name, CONTAINER);
            mapped
        };
        let modules = names.iter().zip(modules).map(map).collect();
        Self { names, modules }
    }

    fn collect_devices(&self, devices: Devices) -> Devices {
        self.modules.collect_devices(devices)
    }

    fn fork(self, device: &Device) -> Self {
        Self { names: self.names, modules: self.modules.fork(device) }
    }

    fn to_device(self, device: &Device) -> Self {
        Self { names: self.names, modules: self.modules.to_device(device) }
    }

    fn train(self) -> Self {
        Self { names: self.names, modules: self.modules.train() }
    }

    fn valid(&self) -> Self {
        Self { names: self.names.clone(), modules: self.modules.valid() }
    }

    fn materialize(self) -> Self {
        Self { names: self.names, modules: self.modules.materialize() }
    }
}

impl<M: ModuleDisplay> ModuleDisplayDefault for Layers<M> {
    fn content(&self, content: Content) -> Option<Content> {
        let layers = self.names.iter().zip(&self.modules);
        layers.fold(content, |content, (name, module)| content.add(name, module)).optional()
    }
}

impl<M: ModuleDisplay> ModuleDisplay for Layers<M> {}
