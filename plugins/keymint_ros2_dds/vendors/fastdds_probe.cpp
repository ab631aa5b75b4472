// SPDX-License-Identifier: Apache-2.0
// A secure participant of Fast DDS 2.9 or 3. It reads one command per line from stdin, and answers each with one line on
// stdout. participants.py, which starts it, describes the protocol.

#include <chrono>
#include <cstdint>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <malloc.h>
#include <unistd.h>

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/log/Log.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#if __has_include(<fastdds/config.hpp>)
#define FAST_DDS_3
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.hpp>
#include <fastdds/utils/IPLocator.hpp>
#else
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>
#endif

namespace fast = eprosima::fastdds::dds;
using Words = std::vector<std::string>;

#ifdef FAST_DDS_3
namespace rtps = eprosima::fastdds::rtps;
constexpr auto DDS_CDR = eprosima::fastcdr::CdrVersion::DDS_CDR;
const auto OK = fast::RETCODE_OK;
#else
namespace rtps = eprosima::fastrtps::rtps;
constexpr auto DDS_CDR = eprosima::fastcdr::Cdr::DDS_CDR;
const auto OK = ReturnCode_t::RETCODE_OK;
#endif

namespace {

constexpr char TYPE_NAME[] = "std_msgs::msg::dds_::String_";
constexpr uint32_t MAX_SERIALIZED = 4096;
constexpr uint32_t AROUND_TEXT = 9;  // bytes of a serialized text: four of encapsulation, four of its length, its NUL
constexpr int PARTICIPANTS = 4;  // peers that each participant looks for
constexpr int KEPT_MEMORY = 64 << 20;  // bytes that are not returned to the system after each endpoint
constexpr auto STEP = std::chrono::milliseconds(2);

// Messages of Fast DDS since they were last read.
class Complaints
{
public:
    void add(std::string text)
    {
        for (char& letter : text)
            letter = letter == '\n' || letter == '\r' ? ' ' : letter;
        std::lock_guard<std::mutex> guard(lock_);
        if (text_.size() < ENOUGH)
            text_ += (text_.empty() ? "" : "; ") + text;
    }

    std::string take()
    {
        fast::Log::Flush();
        std::lock_guard<std::mutex> guard(lock_);
        std::string text;
        std::swap(text, text_);
        return text;
    }

private:
    static constexpr size_t ENOUGH = 2000;
    std::mutex lock_;
    std::string text_;
};

Complaints complaints;

class Consumer : public fast::LogConsumer
{
public:
    void Consume(const fast::Log::Entry& entry) override
    {
        if (entry.kind == fast::Log::Kind::Error)
            complaints.add(entry.message);
    }
};

class Listener : public fast::DomainParticipantListener
{
public:
    void onParticipantAuthentication(fast::DomainParticipant*, rtps::ParticipantAuthenticationInfo&& info) override
    {
        if (info.status == rtps::ParticipantAuthenticationInfo::UNAUTHORIZED_PARTICIPANT)
            complaints.add("remote participant is not authorized");
    }
};

class StringType : public fast::TopicDataType
{
public:
#ifdef FAST_DDS_3
    StringType()
    {
        set_name(TYPE_NAME);
        max_serialized_type_size = MAX_SERIALIZED;
    }

    bool serialize(const void* data, rtps::SerializedPayload_t& payload, fast::DataRepresentationId_t) override
    {
        return write(*static_cast<const std::string*>(data), payload);
    }

    bool deserialize(rtps::SerializedPayload_t& payload, void* data) override
    {
        return read(payload, *static_cast<std::string*>(data));
    }

    uint32_t calculate_serialized_size(const void*, fast::DataRepresentationId_t) override
    {
        return MAX_SERIALIZED;
    }

    void* create_data() override
    {
        return new std::string();
    }

    void delete_data(void* data) override
    {
        delete static_cast<std::string*>(data);
    }

    bool compute_key(rtps::SerializedPayload_t&, rtps::InstanceHandle_t&, bool) override
    {
        return false;
    }

    bool compute_key(const void*, rtps::InstanceHandle_t&, bool) override
    {
        return false;
    }
#else
    StringType()
    {
        setName(TYPE_NAME);
        m_typeSize = MAX_SERIALIZED;
        m_isGetKeyDefined = false;
    }

    bool serialize(void* data, rtps::SerializedPayload_t* payload) override
    {
        return write(*static_cast<std::string*>(data), *payload);
    }

    bool deserialize(rtps::SerializedPayload_t* payload, void* data) override
    {
        return read(*payload, *static_cast<std::string*>(data));
    }

    std::function<uint32_t()> getSerializedSizeProvider(void*) override
    {
        return []() { return MAX_SERIALIZED; };
    }

    void* createData() override
    {
        return new std::string();
    }

    void deleteData(void* data) override
    {
        delete static_cast<std::string*>(data);
    }

    bool getKey(void*, rtps::InstanceHandle_t*, bool) override
    {
        return false;
    }
#endif

private:
    static bool write(const std::string& text, rtps::SerializedPayload_t& payload)
    {
        eprosima::fastcdr::FastBuffer buffer(reinterpret_cast<char*>(payload.data), payload.max_size);
        eprosima::fastcdr::Cdr cdr(buffer, eprosima::fastcdr::Cdr::DEFAULT_ENDIAN, DDS_CDR);
        payload.encapsulation = cdr.endianness() == eprosima::fastcdr::Cdr::BIG_ENDIANNESS ? CDR_BE : CDR_LE;
        cdr.serialize_encapsulation();
        cdr << text;
        payload.length = static_cast<uint32_t>(AROUND_TEXT + text.size());
        return true;
    }

    static bool read(rtps::SerializedPayload_t& payload, std::string& text)
    {
        eprosima::fastcdr::FastBuffer buffer(reinterpret_cast<char*>(payload.data), payload.length);
        eprosima::fastcdr::Cdr cdr(buffer, eprosima::fastcdr::Cdr::DEFAULT_ENDIAN, DDS_CDR);
        cdr.read_encapsulation();
        cdr >> text;
        return true;
    }
};

struct Edge
{
    fast::Topic* topic = nullptr;
    fast::Publisher* publisher = nullptr;
    fast::Subscriber* subscriber = nullptr;
    fast::DataWriter* writer = nullptr;
    fast::DataReader* reader = nullptr;

    int matched() const
    {
        if (writer != nullptr)
        {
            fast::PublicationMatchedStatus status;
            writer->get_publication_matched_status(status);
            return status.current_count;
        }
        fast::SubscriptionMatchedStatus status;
        reader->get_subscription_matched_status(status);
        return status.current_count;
    }
};

class Probe
{
public:
    ~Probe()
    {
        if (participant_ != nullptr)
        {
            participant_->delete_contained_entities();
            fast::DomainParticipantFactory::get_instance()->delete_participant(participant_);
        }
    }

    std::string obey(const Words& words)
    {
        const std::string& command = words[0];
        if (command == "OPEN" && words.size() == 6)
            return open(std::stoul(words[1]), words[2], words[3], std::stoi(words[4]), std::stoi(words[5]));
        if (participant_ == nullptr)
            return "ERROR no participant";
        if (command == "EDGE" && words.size() >= 4)
            return keep_edge(words);
        if (command == "TRY" && words.size() >= 3)
            return try_edge(words);
        const auto found = words.size() > 2 ? edges_.find(words[1]) : edges_.end();
        if (found == edges_.end())
            return "ERROR malformed command";
        if (command == "AWAIT")
            return await_match(found->second, std::stoi(words[2]));
        if (command == "WRITE")
            return write(found->second, words[2]);
        if (command == "READ")
            return read(found->second, std::stoi(words[2]));
        return "ERROR malformed command";
    }

private:
    // The caller chooses the ports, two for each participant, so that systems of different tests never communicate.
    // crl is the name of a revocation list in the folder, or empty.
    std::string open(uint32_t domain, const std::string& folder, const std::string& crl, int first_port, int index)
    {
        fast::DomainParticipantQos qos;
        auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
        transport->interfaceWhiteList.push_back("127.0.0.1");
        qos.transport().use_builtin_transports = false;
        qos.transport().user_transports.push_back(transport);
        auto& builtin = qos.wire_protocol().builtin;
        builtin.discovery_config.initial_announcements.count = 20;
        builtin.discovery_config.initial_announcements.period = {0, 100000000};
        builtin.metatrafficUnicastLocatorList.push_back(loopback(first_port + 2 * index));
        qos.wire_protocol().default_unicast_locator_list.push_back(loopback(first_port + 2 * index + 1));
        for (int other = 0; other < PARTICIPANTS; ++other)
            if (other != index)
                builtin.initialPeersList.push_back(loopback(first_port + 2 * other));

        const std::string file = "file://" + folder + "/";
        set(qos, "dds.sec.auth.plugin", "builtin.PKI-DH");
        set(qos, "dds.sec.auth.builtin.PKI-DH.identity_ca", authority(folder, "identity_ca.cert.pem"));
        set(qos, "dds.sec.auth.builtin.PKI-DH.identity_certificate", file + "cert.pem");
        set(qos, "dds.sec.auth.builtin.PKI-DH.private_key", private_key(folder));
        set(qos, "dds.sec.crypto.plugin", "builtin.AES-GCM-GMAC");
        set(qos, "dds.sec.access.plugin", "builtin.Access-Permissions");
        set(qos, "dds.sec.access.builtin.Access-Permissions.permissions_ca", authority(folder, "permissions_ca.cert.pem"));
        set(qos, "dds.sec.access.builtin.Access-Permissions.governance", file + "governance.p7s");
        set(qos, "dds.sec.access.builtin.Access-Permissions.permissions", file + "permissions.p7s");
        if (!crl.empty())
            set(qos, "dds.sec.auth.builtin.PKI-DH.identity_crl", file + crl);

        participant_ = fast::DomainParticipantFactory::get_instance()->create_participant(
                domain, qos, &listener_, fast::StatusMask::none());
        if (participant_ == nullptr)
            return "REFUSED " + complaints.take();
        type_.register_type(participant_);
        return "OPENED";
    }

    // rmw_fastrtps of Jazzy and later prefers key.p11, if its first word is the URI of a key in a token.
    static std::string private_key(const std::string& folder)
    {
        std::ifstream file(folder + "/key.p11");
        std::string uri;
        const bool in_token = (file >> uri) && uri.rfind("pkcs11:", 0) == 0;
        return in_token ? uri : "file://" + folder + "/key.pem";
    }

    // The layout of Ardent has one file for both authorities.
    static std::string authority(const std::string& folder, const std::string& name)
    {
        const std::string path = folder + "/" + name;
        return "file://" + (access(path.c_str(), F_OK) == 0 ? path : folder + "/ca.cert.pem");
    }

    static rtps::Locator_t loopback(int port)
    {
        rtps::Locator_t locator;
        rtps::IPLocator::setIPv4(locator, "127.0.0.1");
        locator.port = static_cast<uint32_t>(port);
        return locator;
    }

    static void set(fast::DomainParticipantQos& qos, const std::string& name, const std::string& value)
    {
        qos.properties().properties().emplace_back(name, value);
    }

    // The words end with direction, topic and partitions, from index first on.
    bool create(Edge& edge, const Words& words, size_t first)
    {
        edge.topic = static_cast<fast::Topic*>(participant_->lookup_topicdescription(words[first + 1]));
        if (edge.topic == nullptr)
            edge.topic = participant_->create_topic(words[first + 1], TYPE_NAME, fast::TOPIC_QOS_DEFAULT);
        if (edge.topic == nullptr)
            return false;
        fast::PartitionQosPolicy partitions;
        for (size_t i = first + 2; i < words.size(); ++i)
            partitions.push_back(words[i].c_str());
        if (words[first] == "publish")
        {
            fast::PublisherQos group;
            group.partition(partitions);
            fast::DataWriterQos qos;
            qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
            qos.durability().kind = fast::TRANSIENT_LOCAL_DURABILITY_QOS;
            qos.history().kind = fast::KEEP_ALL_HISTORY_QOS;
            qos.endpoint().history_memory_policy = rtps::DYNAMIC_RESERVE_MEMORY_MODE;
            edge.publisher = participant_->create_publisher(group);
            edge.writer = edge.publisher->create_datawriter(edge.topic, qos);
        }
        else
        {
            fast::SubscriberQos group;
            group.partition(partitions);
            fast::DataReaderQos qos;
            qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
            qos.durability().kind = fast::TRANSIENT_LOCAL_DURABILITY_QOS;
            qos.history().kind = fast::KEEP_ALL_HISTORY_QOS;
            qos.endpoint().history_memory_policy = rtps::DYNAMIC_RESERVE_MEMORY_MODE;
            edge.subscriber = participant_->create_subscriber(group);
            edge.reader = edge.subscriber->create_datareader(edge.topic, qos);
        }
        return edge.writer != nullptr || edge.reader != nullptr;
    }

    void discard(const Edge& edge)
    {
        if (edge.writer != nullptr)
            edge.publisher->delete_datawriter(edge.writer);
        if (edge.reader != nullptr)
            edge.subscriber->delete_datareader(edge.reader);
        if (edge.publisher != nullptr)
            participant_->delete_publisher(edge.publisher);
        if (edge.subscriber != nullptr)
            participant_->delete_subscriber(edge.subscriber);
        if (edge.topic != nullptr)
            participant_->delete_topic(edge.topic);  // fails while another edge uses it; then it stays
    }

    std::string keep_edge(const Words& words)
    {
        Edge edge;
        if (create(edge, words, 2))
        {
            edges_[words[1]] = edge;
            return "ALLOWED";
        }
        discard(edge);
        return "DENIED " + complaints.take();
    }

    std::string try_edge(const Words& words)
    {
        Edge edge;
        const bool allowed = create(edge, words, 1);
        discard(edge);
        return allowed ? "ALLOWED" : "DENIED " + complaints.take();
    }

    static std::string await_match(const Edge& edge, int milliseconds)
    {
        const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(milliseconds);
        do
        {
            if (const int count = edge.matched())
                return "MATCHED " + std::to_string(count);
            const std::string complaint = complaints.take();
            if (!complaint.empty())
                return "REJECTED " + complaint;
            std::this_thread::sleep_for(STEP);
        }
        while (std::chrono::steady_clock::now() < end);
        return "TIMEOUT";
    }

    static std::string write(const Edge& edge, std::string text)
    {
        return edge.writer != nullptr && edge.writer->write(&text, rtps::InstanceHandle_t()) == OK ? "WRITTEN" : "ERROR " + complaints.take();
    }

    static std::string read(const Edge& edge, int milliseconds)
    {
        const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(milliseconds);
        do
        {
            std::string text;
            fast::SampleInfo info;
            if (edge.reader != nullptr && edge.reader->take_next_sample(&text, &info) == OK &&
                    info.valid_data)
                return "SAMPLE " + text;
            std::this_thread::sleep_for(STEP);
        }
        while (std::chrono::steady_clock::now() < end);
        return "TIMEOUT";
    }

    Listener listener_;
    fast::TypeSupport type_{new StringType()};
    fast::DomainParticipant* participant_ = nullptr;
    std::map<std::string, Edge> edges_;
};

Words split(const std::string& line)
{
    Words words;
    std::string::size_type begin = 0;
    for (auto end = line.find('\t'); end != std::string::npos; end = line.find('\t', begin))
    {
        words.push_back(line.substr(begin, end - begin));
        begin = end + 1;
    }
    words.push_back(line.substr(begin));
    return words;
}

}  // namespace

int main()
{
    fast::Log::ClearConsumers();
    fast::Log::RegisterConsumer(std::unique_ptr<fast::LogConsumer>(new Consumer()));
    fast::Log::SetVerbosity(fast::Log::Kind::Error);
    mallopt(M_TRIM_THRESHOLD, KEPT_MEMORY);
    mallopt(M_MMAP_THRESHOLD, KEPT_MEMORY);
    std::ios::sync_with_stdio(false);
    std::cin.tie(nullptr);
    {
        Probe probe;
        std::string line;
        while (std::getline(std::cin, line) && line != "CLOSE")
        {
            std::cout << probe.obey(split(line)) << '\n';
            if (std::cin.rdbuf()->in_avail() <= 0)  // else commands wait, and their answers can go together
                std::cout.flush();
        }
    }
    std::cout << "CLOSED" << std::endl;
    return 0;
}
