//! Runs the plugin of zenoh-bridge-ros2dds until standard input ends: `zenoh_bridge KEY=JSON5...`.

use std::{env, io};

use zenoh::internal::{plugins::PluginsManager, runtime::RuntimeBuilder};
use zenoh_plugin_ros2dds::ROS2Plugin;

// Two workers are the plugin's default.
#[tokio::main(worker_threads = 2)]
async fn main() -> zenoh::Result<()> {
    zenoh::init_log_from_env_or("error");
    let mut config = zenoh::Config::default();
    for argument in env::args().skip(1) {
        let (key, value) = argument.split_once('=').ok_or("give keys of its configuration: KEY=JSON5")?;
        config.insert_json5(key, value)?;
    }

    let mut plugins = PluginsManager::static_plugins_only();
    plugins.declare_static_plugin::<ROS2Plugin, _>("ros2dds", true);
    let mut runtime = RuntimeBuilder::new(config).plugins_manager(plugins).build().await?;
    runtime.start().await?;
    io::copy(&mut io::stdin(), &mut io::sink())?;
    Ok(())
}
