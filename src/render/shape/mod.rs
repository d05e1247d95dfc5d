//! What rays hit: shapes, meshes, transforms, instances, and the tree over them.
