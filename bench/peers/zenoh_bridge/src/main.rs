//! Runs the plugin of zenoh-bridge-ros2dds until standard input ends: `zenoh_bridge DOMAIN listen|connect ENDPOINT`.

use std::{env, io};

use zenoh::internal::{plugins::PluginsManager, runtime::RuntimeBuilder};
use zenoh_plugin_ros2dds::ROS2Plugin;

// Two workers are the plugin's default.
#[tokio::main(worker_threads = 2)]
async fn main() -> zenoh::Result<()> {
    zenoh::init_log_from_env_or("error");
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [domain, part, endpoint] = &arguments[..] else {
        return Err("give a domain, listen or connect, and an endpoint".into());
    };
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "'router'")?; // the default of zenoh-bridge-ros2dds, not of the library
    config.insert_json5("scouting/multicast/enabled", "false")?;
    config.insert_json5("scouting/gossip/enabled", "false")?;
    config.insert_json5("listen/endpoints", "[]")?; // a router listens at a fixed port, and there are two
    config.insert_json5(&format!("{part}/endpoints"), &format!("['{endpoint}']"))?;
    config.insert_json5("plugins/ros2dds/domain", domain)?;

    let mut plugins = PluginsManager::static_plugins_only();
    plugins.declare_static_plugin::<ROS2Plugin, _>("ros2dds", true);
    let mut runtime = RuntimeBuilder::new(config).plugins_manager(plugins).build().await?;
    runtime.start().await?;
    io::copy(&mut io::stdin(), &mut io::sink())?;
    Ok(())
}
