#pragma once

#include <ros/ros.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <chrono>
#include <exception>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "block_serialization.hpp"
#include "block_worker.hpp"
#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "parameter_server.hpp"
#include "stage_health.hpp"

namespace field_phenotyping {

/// Messages that may wait between two stages. Long, because a lost block is a lost plant; the
/// stages themselves keep only the newest revision of each block.
constexpr std::uint32_t kChainQueue = 200U;

/// `~flush` gives up when no block has been finished for so long.
constexpr std::chrono::seconds kFlushStalled(120);

/// Private parameters that every stage reads besides its section.
const std::set<std::string>& commonParameterNames();

/// `overload_after` [s] and `most_points_waiting`.
OverloadLimits overloadLimitsOf(const ros::NodeHandle& pnh);

/// Says so when what a stage reads once at its start is no number or out of range.
void checkFixedParameters(const ros::NodeHandle& pnh, StageHealth& health);

/// The device that `~device` asks for; the CPU where it cannot be had, which is said.
ComputeDevice chooseDevice(const ros::NodeHandle& pnh, StageHealth& health);

/// Shows what a stage's device has done, and says so when the GPU has failed.
void showDeviceUse(const ComputeDevice& device, StageHealth& health);

/// Holds work back until somebody listens, so that what arrives while the other nodelets are still
/// being loaded is not handed on into the void; after `~wait_for_subscriber` [s, default 10] work
/// begins regardless.
class ListenerGate {
 public:
  ListenerGate(const ros::NodeHandle& pnh, const ros::Publisher& output);
  bool open();

 private:
  ros::Publisher output_;
  ros::SteadyTime give_up_;
  bool open_ = false;
};

/// What the stages that work block by block have in common: `~input` → worker thread → `~output`,
/// parameters, diagnostics and `~flush`. After a change of parameters the last blocks are worked
/// again, so that tuning shows its effect while no data flows.
template <class Input, class Output, class Config, class Section>
class BlockStage {
 public:
  using InputPtr = boost::shared_ptr<const Input>;
  using OutputPtr = boost::shared_ptr<const Output>;
  using Drafts = typename BlockWorker<Input>::Drafts;
  /// Makes what is published, in that order; nothing where that is not worth it any more. Called on
  /// the worker's threads; may throw.
  using Work = std::function<std::vector<OutputPtr>(const InputPtr&, const Section&)>;

  BlockStage(const ros::NodeHandle& nh, const ros::NodeHandle& pnh, const std::string& name)
      : pnh_(pnh),
        health_(nh, pnh_, name, "block"),
        device_(chooseDevice(pnh_, health_)),
        parameters_(pnh_, health_, commonParameterNames(), [this] { parameters_changed_ = true; }),
        output_(pnh_.advertise<Output>("output", kChainQueue)),
        gate_(pnh_, output_) {
    checkFixedParameters(pnh_, health_);
  }
  ~BlockStage() { stop(); }

  /// Begins to take input. Call it last, when everything that `work` and `idle` use is there.
  /// @param idle called often on one of the worker's threads, for displays
  /// @param drafts kBeside: `work` may be called by two threads at once, and `idle` meanwhile
  void start(Work work, std::function<void()> idle, Drafts drafts = Drafts::kInTurn) {
    work_ = std::move(work);
    typename BlockWorker<Input>::Calls calls;
    calls.ready = [this] { return gate_.open(); };
    calls.work = [this](const Task& task) { workOn(task); };
    calls.idle = [this, idle = std::move(idle)] {
      if (parameters_changed_.exchange(false)) worker_->reworkAll();
      guarded(idle);
    };
    worker_ = std::make_unique<BlockWorker<Input>>(historyOf(pnh_), overloadLimitsOf(pnh_),
                                                   std::move(calls), drafts);
    worker_->start();
    flush_ = pnh_.advertiseService("flush", &BlockStage::flush, this);
    input_ = pnh_.subscribe("input", kChainQueue, &BlockStage::receive, this);
  }

  /// No callback and no work happens after this. Call it before anything `work` uses goes.
  void stop() {
    input_.shutdown();
    flush_.shutdown();
    // Not reset(): what is at work still asks it.
    if (worker_) worker_->stop();
  }

  ros::NodeHandle& privateHandle() { return pnh_; }
  StageHealth& health() { return health_; }
  const ComputeDevice& device() const { return device_; }

 private:
  using Task = typename BlockWorker<Input>::Task;

  void receive(const InputPtr& block) {
    health_.received(ros::Time().fromNSec(headerOf(*block).stamp_ns));
    const auto arrival = worker_->push(block);
    if (arrival.replaced) health_.count("revisions skipped for newer ones");
    if (arrival.dropped > 0U) health_.count("blocks dropped: overload", arrival.dropped);
    if (worker_->overloaded()) tellOverload();
  }

  void tellOverload() {
    health_.trouble("overload",
                    "blocks come faster than they are worked: those that nothing is known of yet "
                    "and the newest go first, " +
                        std::to_string(health_.counted("blocks dropped: overload")) +
                        " were dropped so far. Drive slower, raise voxel_size or update_period, "
                        "lower max_range, or let more cores work");
  }

  void workOn(const Task& task) {
    std::optional<UrgentWork> urgent;
    if (headerOf(*task.block).draft) urgent.emplace();
    guarded([&] {
      const ros::SteadyTime begin = ros::SteadyTime::now();
      const std::vector<OutputPtr> made = work_(task.block, parameters_.current());
      if (made.empty()) return;
      for (const OutputPtr& output : made) output_.publish(output);
      const ros::SteadyTime end = ros::SteadyTime::now();
      health_.count("blocks worked");
      health_.finished((end - task.arrival).toSec());
      health_.took("work on a block", (end - begin).toSec());
    });
    health_.show("blocks waiting", static_cast<double>(worker_->waiting()));
  }

  /// One bad block must not take the manager with it.
  template <class Call>
  void guarded(Call&& call) {
    try {
      call();
    } catch (const std::exception& error) {
      health_.count("blocks failed");
      health_.trouble("exception", std::string("a block was given up: ") + error.what());
    }
  }

  bool flush(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    response.success = worker_->drain(kFlushStalled);
    response.message = response.success ? "all blocks are worked" : "one block has taken 120 s";
    return true;
  }

  ros::NodeHandle pnh_;
  StageHealth health_;
  const ComputeDevice device_;
  std::atomic<bool> parameters_changed_{false};
  ParameterServer<Config, Section> parameters_;
  ros::Publisher output_;
  ListenerGate gate_;
  Work work_;
  std::unique_ptr<BlockWorker<Input>> worker_;
  ros::ServiceServer flush_;
  ros::Subscriber input_;
};

}  // namespace field_phenotyping
