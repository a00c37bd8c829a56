// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

/// @notice What the provider wants: only Active services get new tasks, Retired is for good.
enum ServiceState {
    None,
    Active,
    Paused,
    Retired
}

/// @notice How an attempt ended for the service that made it. Unjudged: the oracle did not answer in time.
enum Outcome {
    Completed,
    Rejected,
    Expired,
    Unjudged
}

/// @param price what one task costs, in the token's smallest unit
/// @param taskId the task it is doing; 0 when it does none
/// @param place its place among the idle services: lower was there earlier; 0 when it does not wait
/// @param completed attempts that were accepted
/// @param rejected attempts that were rejected
/// @param expired attempts without a proof in time
struct Service {
    address provider;
    uint96 price;
    bytes32 kind;
    uint64 taskId;
    uint64 place;
    ServiceState state;
    uint32 completed;
    uint32 rejected;
    uint32 expired;
}

/// @title Who offers which work at which price, and who waits for a task.
/// @notice A service does one task at a time. While it does one, its provider can change the price and the
/// state for what comes after, but nothing about the running task.
interface IServiceManager {
    event ServiceRegistered(
        uint256 indexed serviceId,
        address indexed provider,
        bytes32 indexed kind,
        uint256 price,
        string description
    );
    event ServiceUpdated(uint256 indexed serviceId, uint256 price, ServiceState state);

    error UnknownService(uint256 serviceId);
    error NotProvider(uint256 serviceId, address caller, address provider);
    error ServiceIsRetired(uint256 serviceId);
    /// @notice A provider can set Active, Paused and Retired.
    error InvalidServiceState(ServiceState state);
    /// @notice A price is a multiple of `unit`, so that it can be compared in 64 bits, and at most `max`.
    error InvalidPrice(uint256 price, uint256 unit, uint256 max);
    error ServiceNotIdle(uint256 serviceId);
    error NotTaskManager(address caller);

    /// @notice Offer work of `kind` for `price` a task. The oldest open task that it can do is assigned at once.
    /// @param description free text; only in the event
    function registerService(bytes32 kind, uint256 price, string calldata description)
        external
        returns (uint256 serviceId);

    /// @notice Change what the service costs and whether it takes tasks, from the next task on. A service that
    /// was waiting queues again at the back.
    function updateService(uint256 serviceId, uint256 price, ServiceState state) external;

    /// @notice The service, as it is now. Reverts with UnknownService.
    function service(uint256 serviceId) external view returns (Service memory);

    /// @notice Who does and is paid for the service's tasks; never changes. Reverts with UnknownService.
    function providerOf(uint256 serviceId) external view returns (address);

    /// @notice How many services were ever registered; the last id.
    function serviceCount() external view returns (uint256);

    /// @notice The service of `kind` that has waited longest among those that cost at most `maxPrice`; 0 if none.
    function longestIdle(bytes32 kind, uint256 maxPrice) external view returns (uint256 serviceId);

    /// @notice Whether the service waits for a task of `kind` and costs at most `maxPrice`.
    function isIdle(uint256 serviceId, bytes32 kind, uint256 maxPrice) external view returns (bool);

    /// @notice Occupy an available service with a task. Only the task manager.
    /// @return provider who will be paid
    /// @return price the price agreed for this task
    function acquire(uint256 serviceId, uint256 taskId) external returns (address provider, uint256 price);

    /// @notice The service's task ended. Only the task manager, which places or offers it next.
    /// @return available whether the provider wants another task
    /// @return price what that one costs
    function release(uint256 serviceId, Outcome outcome) external returns (bool available, uint256 price);

    /// @notice Let an available service wait, behind the others of its kind. Only the task manager.
    function offer(uint256 serviceId) external;
}
